"""`vitac admin advance`: who takes part in a stage for qualified teams."""

import sys
from typing import Annotated

import typer
from sqlalchemy.orm import Session
from vitac.server.competitions.competition import Competition
from vitac.server.decisions.advancement import confirm as confirm_teams
from vitac.server.decisions.advancement import propose as propose_teams
from vitac.server.decisions.advancement import qualified_revision, qualified_teams
from vitac.server.principals import CONSOLE

from ...service.database import transaction
from ...terminal.output import AsJson, percent, print_json, print_table, warn
from ..consent import Base, DryRun, Yes, change_as_shown, resolve_base
from .competition import CompetitionName, StageName, TrackName

app = typer.Typer(no_args_is_help=True, rich_markup_mode=None)

TeamNames = Annotated[list[str] | None, typer.Option(help="Name or id of a team; may be given several times.")]


@app.command()
def propose(track: TrackName, stage: StageName, competition: CompetitionName = None, as_json: AsJson = False) -> None:
    """Show who advances to a stage by its rule, and which teams are so near the border that chance may decide."""
    with transaction() as session:
        found = propose_teams(session, CONSOLE, Competition.find(session, competition, track=track).stage(track, stage))
    if as_json:
        print_json(found.model_dump(mode="json"))
        return
    rows = [
        [
            team.rank,
            team.team,
            percent(team.success_rate),
            " to ".join(str(percent(end)) for end in team.interval),
            team.mean_steps,
            "yes" if team.advances else "no",
            "at the border" if team.at_border else None,
        ]
        for team in found.teams
    ]
    print(f"{found.rule}, by the board of {found.before}; {found.registered} teams are registered.")
    columns = ("rank", "team", "success", "95 % interval", "steps", "advances", "")
    print_table(columns, rows, none=f"No team is ranked in {found.before}.")
    if found.unranked:
        print(f"Not ranked, made by another evaluator version: {', '.join(found.unranked)}. Requeue them first.")
    if found.running:
        print(f"{found.running} evaluations of {found.before} wait or run.")


@app.command()
def confirm(
    track: TrackName,
    stage: StageName,
    add: TeamNames = None,
    without: TeamNames = None,
    base: Base = None,
    competition: CompetitionName = None,
    yes: Yes = False,
    dry_run: DryRun = False,
    as_json: AsJson = False,
) -> None:
    """Confirm the teams that take part in a stage: those proposed, with --add and --without."""

    def change(session: "Session") -> list[str]:
        found = Competition.find(session, competition, track=track).stage(track, stage)
        made_from = resolve_base(base, yes=yes and not dry_run)
        return confirm_teams(session, CONSOLE, found, add=add or (), without=without or (), base=made_from)

    def show(found: list[str]) -> None:
        if as_json:
            print_json({"track": track, "stage": stage, "teams": found})
        else:
            print(f"{stage} of {track}: {', '.join(found) or 'no team'}")
        if not found:
            warn(f"no team takes part in {stage} of {track}; `vitac admin advance propose` shows the board before.")

    change_as_shown(
        change,
        show,
        lambda found: f"Let these {len(found)} teams take part in {stage} of {track}?",
        yes=yes,
        dry_run=dry_run,
    )


@app.command("list")
def list_teams(
    track: TrackName, stage: StageName, competition: CompetitionName = None, as_json: AsJson = False
) -> None:
    """List the teams that were confirmed for a stage."""
    with transaction() as session:
        wanted = Competition.find(session, competition, track=track).stage(track, stage)
        found, revision = qualified_teams(session, wanted), qualified_revision(session, wanted)
    if as_json:
        print_json(found)
    else:
        print("\n".join(found) or "Nobody was confirmed.")
    if found:
        print(f"To confirm other teams without a question: --yes --base {revision}", file=sys.stderr)
