"""`vitac admin quota`: what teams may have, and how much of it they use."""

from collections.abc import Sequence
from typing import Annotated

import typer
from sqlalchemy.orm import Session
from vitac.server.accounts import quotas, teams
from vitac.server.accounts.quotas import uses
from vitac.server.database.states import Quota
from vitac.server.principals import CONSOLE
from vitac.server.views.teams import QuotaView

from ..service.database import load_settings
from ..terminal.output import AsJson, print_done
from .consent import DryRun, change_transaction
from .verbs import list_records

app = typer.Typer(no_args_is_help=True, rich_markup_mode=None)

UNLIMITED, DEFAULT = "unlimited", "default"

TeamName = Annotated[str, typer.Argument(help="Name or id of the team.")]


@list_records(app, "quota", "limit", "used", "opens_at", none="No quota.")
def list_quotas(session: Session, team: TeamName) -> Sequence[QuotaView]:
    """List the quotas of a team and how much of each is used."""
    return uses(session, load_settings().quotas, teams.find(session, team).id)


@app.command("set")
def set_quota(
    team: TeamName,
    quota: Annotated[Quota, typer.Argument(help="The quota, as `list` shows it.")],
    limit: Annotated[str, typer.Argument(help=f"A number, {UNLIMITED}, or {DEFAULT} for the setting's.")],
    dry_run: DryRun = False,
    as_json: AsJson = False,
) -> None:
    """Give a team a limit of its own."""
    if limit not in {UNLIMITED, DEFAULT} and not (limit.isascii() and limit.isdigit() and len(limit) < 10):
        raise typer.BadParameter(f"expected a number, {UNLIMITED} or {DEFAULT}, got {limit!r}")
    with change_transaction(dry_run=dry_run) as session:
        found = teams.find(session, team)
        if limit == DEFAULT:
            quotas.reset_quota(session, CONSOLE, found, quota)
        else:
            quotas.set_quota(session, CONSOLE, found, quota, None if limit == UNLIMITED else int(limit))
        used = quotas.uses(session, load_settings().quotas, found.id)
        sentence = f"{quota} of {found.name}: {limit}"
    print_done(sentence, next(use.model_dump() for use in used if use.quota == quota), as_json=as_json)
