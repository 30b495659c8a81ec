"""Verbs of `vitac admin` that read or write files; and `token add`, whose role is an option."""

from __future__ import annotations

import io
import sys
import zipfile
from functools import partial
from pathlib import Path
from typing import Annotated, Literal

import typer
from vitac.errors import VitacError

from ..client.verbs import NOTHING_CHANGED, DryRun, Yes, print_fields
from ..terminal.episode_counter import EpisodeCounter
from ..terminal.output import AsJson, Processes, TokenFile, existing, print_json, print_record
from .door import Server, open_door

HUMAN_BASELINE = "PUT /tracks/{track}/tasks/{task}/human-baseline"
STAGE_SUBMISSIONS = "GET /competitions/{competition}/tracks/{track}/stages/{stage}/submissions"
CompetitionName = Annotated[
    str | None, typer.Option("--competition", help="Name of the competition; needed where there are several.")
]


class NothingByTouch(VitacError):
    """A folder of demonstrations has no episode that a person played by marker flow alone."""


class FileNotWritten(VitacError):
    """A file or folder exists or cannot be made; name a new one."""


def publish(
    context: typer.Context,
    folder: Annotated[Path, typer.Argument(help="New folder for the files.")],
    competition: CompetitionName = None,
    server: Server = None,
    token_file: TokenFile = None,
    as_json: AsJson = False,
) -> None:
    """Write the results as JSON, CSV, a page to print and certificates."""
    with open_door(context, server, token_file) as door:
        answer = door.send("GET /competitions/{competition}/results", {"competition": competition})
    try:
        folder.mkdir()
        with zipfile.ZipFile(io.BytesIO(answer.content)) as archive:
            archive.extractall(folder)
            written = [str(folder / name) for name in archive.namelist()]
    except OSError as error:
        raise FileNotWritten(f"{folder} cannot be made: {error.strerror}. Name a new folder.") from error
    if as_json:
        print_json(written)
    else:
        print("\n".join(written))


def download(
    context: typer.Context,
    track: Annotated[str, typer.Argument(help="Name of the track.")],
    stage: Annotated[str, typer.Argument(help="Name of the stage.")],
    file: Annotated[Path, typer.Argument(help="New file (zip).")],
    competition: CompetitionName = None,
    server: Server = None,
    token_file: TokenFile = None,
    as_json: AsJson = False,
) -> None:
    """Write all submissions of a stage to a zip, by team, with an index."""
    _refuse_existing(file)
    with open_door(context, server, token_file) as door:
        answer = door.send(STAGE_SUBMISSIONS, {"competition": competition, "track": track, "stage": stage})
    file.write_bytes(answer.content)
    saved = {"file": str(file), "bytes": len(answer.content)}
    print_record(saved, as_json=as_json)


def export(
    context: typer.Context,
    track: Annotated[str, typer.Argument(help="Track of the board.")],
    file: Annotated[Path, typer.Argument(help="New file (zip).")],
    task: Annotated[str | None, typer.Option(help="The board of this task; by default that of all tasks.")] = None,
    stage: Annotated[str | None, typer.Option(help="Name of the stage; by default the one that opened last.")] = None,
    kind: Annotated[
        Literal["model", "log"], typer.Option(help="Kind of submission on the board; log only with --task.")
    ] = "model",
    competition: CompetitionName = None,
    server: Server = None,
    token_file: TokenFile = None,
    as_json: AsJson = False,
) -> None:
    """Write a board with receipts, records and teams' sensors for `vitac receipt audit`.

    Records and sensors of a sealed list are left out until its secret is published.
    """
    from vitac.server.receipts.export import ExportReader

    values = {"track": track, "task": task, "stage": stage, "kind": kind, "competition": competition}
    _refuse_existing(file)
    with open_door(context, server, token_file) as door:
        answer = door.send("GET /leaderboards/{track}/receipts", values)
    _refuse_existing(file)
    try:
        file.write_bytes(answer.content)
    except OSError as error:
        raise FileNotWritten(f"{file} cannot be made: {error.strerror}. Name a new file.") from error
    with ExportReader.opened(file) as export:
        description = export.description
    content = {"file": str(file), "entries": len(description.board.entries), "public_key": description.public_key}
    print_record(content, as_json=as_json)


def publish_baseline(
    context: typer.Context,
    folder: Annotated[Path, typer.Argument(callback=existing, help="Folder of a task that `vitac play` has made.")],
    dry_run: DryRun = False,
    yes: Yes = False,  # noqa: ARG001 - nobody is asked
    processes: Processes = 1,
    server: Server = None,
    token_file: TokenFile = None,
    as_json: AsJson = False,
) -> None:
    """Show on a task's public boards what people solved by hand, in place of what was shown before.

    All their episodes by marker flow alone count, and each is played again here first: what differs is refused.
    """
    from vitac.evaluator.scoring.score import read_measures
    from vitac.training.demonstrations.collecting import DemonstrationKind
    from vitac.training.demonstrations.replaying import read_folder, replay

    source, demonstrations = read_folder(folder)
    felt = [each for each in demonstrations if each.kind is DemonstrationKind.HUMAN]
    if not felt:
        raise NothingByTouch(f"{folder} has no episode that was played by marker flow alone; play some: vitac play.")
    with EpisodeCounter() as counter:
        report = partial(counter.show_played, folder)
        last_infos = replay(source, felt, count=len(felt), processes=processes, report=report)
    episodes = [
        {
            "shape": each.shape,
            "is_solved": each.is_success,
            "env_steps": each.actions.shape[0],
            "measures": read_measures(last_infos[each.episode], source.task.definition.measures),
        }
        for each in felt
    ]
    values = {"track": source.manifest.track, "task": source.manifest.task, "episodes": episodes}
    with open_door(context, server, token_file) as door:
        answer = door.call(HUMAN_BASELINE, values, dry_run=dry_run)
    if dry_run:
        print(NOTHING_CHANGED, file=sys.stderr)
    if as_json:
        print_json(answer)
    else:
        print_fields({name: answer[name] for name in ("name", "episodes", "successes", "success_rate_interval")})


def _refuse_existing(file: Path) -> None:
    if file.exists():
        raise FileNotWritten(f"{file} cannot be made: it exists. Name a new file.")


def add_token(
    context: typer.Context,
    team: Annotated[
        str | None, typer.Argument(help="Name or id of the team; none with --organizer or --judge.")
    ] = None,
    organizer: Annotated[
        bool,
        typer.Option(
            "--organizer", help="A token that may do everything, or with --competition everything in one competition."
        ),
    ] = False,
    judge: Annotated[
        bool, typer.Option("--judge", help="A token that reads all teams' submissions and gives marks.")
    ] = False,
    competition: Annotated[
        str | None, typer.Option("--competition", help="With --organizer: the only competition that the token is for.")
    ] = None,
    label: Annotated[str | None, typer.Option(help="What the token is for; for a judge, the judge's name.")] = None,
    days: Annotated[
        int | None, typer.Option(min=1, help="Days until it expires; default: VITAC_TOKEN_LIFETIME_DAYS.")
    ] = None,
    dry_run: DryRun = False,
    yes: Yes = False,  # noqa: ARG001 - nobody is asked
    server: Server = None,
    token_file: TokenFile = None,
    as_json: AsJson = False,
) -> None:
    """Add a token and print it; it is shown only once.

    `--organizer --competition NAME` is for somebody who organizes one of several competitions and sees no other.
    """
    if (team is not None) + organizer + judge != 1:
        raise typer.BadParameter("give one of TEAM, --organizer and --judge")
    if judge and label is None:
        raise typer.BadParameter("name the judge with --label: marks and conflicts of interest are stored under it")
    if competition is not None and not organizer:
        raise typer.BadParameter("--competition is for --organizer: only an organizer's token is for one competition")
    values = {
        "team": team,
        "role": "organizer" if organizer else "judge" if judge else None,
        "competition": competition,
        "label": label or "added by an organizer",
        "expires_in_days": days,
    }
    with open_door(context, server, token_file) as door:
        answer = door.call("POST /tokens", values, dry_run=dry_run)
    if dry_run:
        print(NOTHING_CHANGED, file=sys.stderr)
        answer |= {"id": None, "secret": None}
    if as_json:
        print_json(answer)
        return
    print_fields(answer)
    if not dry_run:
        print("\nThe secret is not shown again. It is used as VITAC_TOKEN.")
