"""`vitac admin appeal`: appeals of teams; an episode is played again beside its result, and the appeal decided."""

from pathlib import Path
from typing import Annotated

import typer
from sqlalchemy.orm import Session
from vitac.server.appeals.appeals import appeal_view, find, note_replay, visible
from vitac.server.appeals.appeals import rule as rule_on
from vitac.server.principals import CONSOLE
from vitac.server.views.appeals import AppealReplayView, AppealView
from vitac.worker import appeal_replay

from ..service.database import load_settings, open_service, transaction
from ..terminal.outcomes import print_meanings
from ..terminal.output import AsJson, print_json, print_pairs, print_record, print_records
from .consent import DryRun, take_back
from .verbs import change, list_records

app = typer.Typer(no_args_is_help=True, rich_markup_mode=None)

AppealNumber = Annotated[int, typer.Argument(min=1, max=2_147_483_647, help="Number of the appeal.")]


@list_records(app, "id", "state", "team", "submission_name", "task", "episode", "opened_at", none="No appeal.")
def list_appeals(
    session: Session,
    open_only: Annotated[bool, typer.Option("--open", help="Only appeals that are not decided.")] = False,
) -> list[AppealView]:
    """List the appeals of all teams, newest first."""
    return visible(session, CONSOLE, open_only=open_only)


@app.command()
def show(appeal: AppealNumber, as_json: AsJson = False) -> None:
    """Show an appeal, and what was played again for it."""
    with transaction() as session:
        found = appeal_view(find(session, CONSOLE, appeal), CONSOLE).model_dump()
    if as_json:
        print_json(found)
        return
    replays = found.pop("replays")
    print_pairs(found)
    print()
    columns = ("task", "episode", "corrected", "old_outcome", "outcome", "old_env_steps", "env_steps", "same_states")
    print_records(replays, columns, none="No episode was played again.", as_json=False)
    print_meanings(end for replay in replays for end in (replay["old_outcome"], replay["outcome"]))


@app.command()
def replay(
    appeal: AppealNumber,
    task: Annotated[str, typer.Argument(help="Task of the episode.")],
    episode: Annotated[int, typer.Argument(min=1, max=2_147_483_647, help="Number of the episode.")],
    corrected: Annotated[
        Path | None, typer.Option(exists=True, dir_okay=False, help="Zip with another policy than the submission's.")
    ] = None,
    dry_run: DryRun = False,
    as_json: AsJson = False,
) -> None:
    """Play an episode again on this machine; the stored result and the boards stay as they are."""
    with open_service(load_settings()) as services:
        played = appeal_replay.replay(services, CONSOLE, appeal, task=task, episode=episode, corrected=corrected)
        with services.database.transaction() as session:
            made = note_replay(
                session,
                CONSOLE,
                appeal,
                played.record,
                policy_sha256=played.policy_sha256,
                corrected=played.corrected,
            )
            shown = AppealReplayView.model_validate(made, from_attributes=True).model_dump()
            failure = played.record.failure.message if played.record.failure is not None else None
            if dry_run:
                take_back(session)
    print_record(shown | {"failure": failure}, as_json=as_json)


@change(app)
def rule(
    session: Session,
    appeal: AppealNumber,
    text: Annotated[str, typer.Argument(help="The ruling, as plain text for the team.")],
    upheld: Annotated[bool, typer.Option("--uphold/--reject", help="Decide for the team; without it, against it.")],
) -> dict[str, object]:
    """Decide an appeal. No result changes; `vitac admin submission requeue` evaluates again."""
    found = rule_on(session, CONSOLE, appeal, text, upheld=upheld)
    session.flush()
    return appeal_view(found, CONSOLE).model_dump(exclude={"replays"})
