"""`vitac admin competition`: the competition's file, its stages and their sealed lists."""

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer
from sqlalchemy.orm import Session
from vitac.server.competitions.applying import Change, list_concerns, list_warnings
from vitac.server.competitions.applying import apply as apply_definition
from vitac.server.competitions.competition import Competition
from vitac.server.competitions.definition import read_competition
from vitac.server.competitions.sealing import reveal as reveal_list
from vitac.server.competitions.sealing import sealed_lists
from vitac.server.confirmations import Concern
from vitac.server.principals import CONSOLE

from ...service.database import transaction
from ...terminal.output import AsJson, moment, print_json, print_pairs, print_record, print_table, warn
from ..consent import Base, Confirmed, DryRun, Yes, change_as_shown, change_transaction, resolve_base, resolve_confirmed
from ..verbs import list_records

app = typer.Typer(no_args_is_help=True, rich_markup_mode=None)

CompetitionFile = Annotated[Path, typer.Argument(help="The competition's file (YAML).", exists=True, dir_okay=False)]
TrackName = Annotated[str, typer.Argument(help="Name of the track.")]
StageName = Annotated[str, typer.Argument(help="Name of the stage.")]
CompetitionName = Annotated[
    str | None, typer.Option("--competition", help="Name of the competition; needed where there are several.")
]


@app.command()
def check(file: CompetitionFile, as_json: AsJson = False) -> None:
    """Check a competition's file without a service; the exit code is 0 if it can be applied."""
    found = read_competition(file)
    if as_json:
        print_json(found.model_dump(mode="json"))
        return
    print_table(
        ("track", "stage", "opens", "closes", "takes", "list", "for"),
        [
            [
                name,
                stage.name,
                moment(stage.opens),
                moment(stage.closes),
                ", ".join(stage.accepts) if track.taken_here else "elsewhere",
                stage.list.value if track.taken_here else None,
                stage.qualified.sentence if stage.qualified else "all teams",
            ]
            for name, track in found.tracks.items()
            for stage in track.stages
        ],
        none="",
    )


@app.command()
def apply(
    file: CompetitionFile,
    base: Base = None,
    confirm: Confirmed = None,
    yes: Yes = False,
    dry_run: DryRun = False,
    as_json: AsJson = False,
) -> None:
    """Show what a competition's file changes, ask, and apply it; other competitions stay as they are."""
    definition, without_question = read_competition(file), yes and not dry_run

    def change(session: "Session") -> "tuple[list[Change], list[Concern], str]":
        revision, concerns = Competition.read(session, definition.name).revision, list_concerns(session, definition)
        made_from, confirmed = (
            resolve_base(base, yes=without_question),
            resolve_confirmed(confirm, yes=without_question),
        )
        found = apply_definition(session, CONSOLE, definition, base=made_from, confirmed=confirmed)
        return found, concerns, revision

    def show(shown: "tuple[list[Change], list[Concern], str]") -> None:
        found, _, revision = shown
        _print_changes(found, as_json=as_json)
        for warning in list_warnings(definition, found) if found else ():
            warn(warning)
        if dry_run and found and revision:
            print(f"Made against revision {revision}: --yes needs --base {revision}.", file=sys.stderr)

    change_as_shown(
        change,
        show,
        lambda shown: f"Apply these {len(shown[0])} changes?" if shown[0] else None,
        concerns=lambda shown: shown[1],
        yes=yes,
        dry_run=dry_run,
    )


@app.command()
def show(competition: CompetitionName = None, as_json: AsJson = False) -> None:
    """Show a competition of this service."""
    with transaction() as session:
        shown = Competition.find(session, competition)
    found = shown.definition
    if as_json:
        print_json(found.model_dump(mode="json") if shown.is_held else None)
    elif not shown.is_held:
        print("No competition; `vitac admin competition apply FILE` makes one.")
    else:
        stages = ", ".join(f"{stage.track}/{stage.name}" for stage in shown.stages)
        names = {"competition": found.name, "title": found.title, "stages": stages}
        print_pairs(names | {"revision": shown.revision})


@list_records(
    app,
    *("track", "stage", "commitment", "withdrawn_at", "revealed_at", "secret"),
    none="No stage plays a sealed list.",
    name="lists",
)
def list_sealed(session: Session, competition: CompetitionName = None) -> list[dict[str, object]]:
    """List the sealed lists of stages: commitments to publish before a stage, secrets once they are revealed."""
    return [
        {
            "track": each.track,
            "stage": each.stage,
            "commitment": each.commitment,
            "withdrawn_at": each.withdrawn_at,
            "revealed_at": each.revealed_at,
            "secret": each.secret if each.revealed_at else None,
        }
        for each in sealed_lists(session, Competition.find(session, competition))
    ]


@app.command()
def reveal(
    track: TrackName,
    stage: StageName,
    competition: CompetitionName = None,
    yes: Yes = False,
    dry_run: DryRun = False,
    as_json: AsJson = False,
) -> None:
    """Publish the secret of a stage's sealed list after the stage has closed; this cannot be undone."""
    with transaction() as session:
        Competition.find(session, competition, track=track).stage(track, stage).require_over()
    question = f"Publish the episodes of stage {stage} of {track}? This cannot be undone."
    with change_transaction(dry_run=dry_run, question=question, yes=yes) as session:
        over = Competition.find(session, competition, track=track).stage(track, stage)
        over.require_over()  # the stage may have been prolonged meanwhile
        found = reveal_list(session, CONSOLE, over)
        shown = {"track": track, "stage": stage, "commitment": found.commitment, "secret": found.secret}
    print_record(shown | ({"secret": None} if dry_run else {}), as_json=as_json)


def _print_changes(changes: "Sequence[Change]", *, as_json: bool) -> None:
    if as_json:
        print_json([vars(change) for change in changes])
        return
    rows = [[change.place, _shown(change.before), _shown(change.after)] for change in changes]
    print_table(("what", "before", "after"), rows, none="Nothing changes.")


def _shown(value: object) -> str | None:
    return ", ".join(map(str, value)) if isinstance(value, list) else None if value is None else str(value)
