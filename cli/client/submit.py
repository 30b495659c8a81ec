"""`vitac submit`: uploads a model, an image or a log to a service."""

import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer
from vitac.evaluator.submission_kinds import SubmissionKind, kind_of_file

from ..evaluate import Image
from ..terminal.output import AsJson, Server, TokenFile, existing, note_ignored_folders, print_json
from .http import Client, Json, make_client
from .pieces import pack
from .progress import describe_place, missing_tasks, nobody
from .status import format_time, has_ended, show_when_ended

CHECKING = "the service checks it"


def command(
    submission: Annotated[
        Path,
        typer.Argument(callback=existing, help="Folder or zip of a model, FILE.tar, .jsonl or .log (.gz)."),
    ],
    track: Annotated[
        str | None, typer.Option(help="Track to submit to; by default the one named in the submission.")
    ] = None,
    competition: Annotated[
        str | None, typer.Option(help="Name of the competition; needed where several take submissions to the track.")
    ] = None,
    server: Server = None,
    token_file: TokenFile = None,
    kind: Annotated[
        SubmissionKind | None,
        typer.Option(help="Kind of submission; by default from the name: .tar image, .jsonl log, .log 2025 text log."),
    ] = None,
    image: Image = False,
    team: Annotated[str | None, typer.Option(help="For organizers: the team that submits.")] = None,
    again: Annotated[bool, typer.Option("--again", help="Run all episodes, including stored ones.")] = False,
    watch: Annotated[bool, typer.Option("--watch", help="Wait for the evaluation and show its progress.")] = False,
    as_json: AsJson = False,
) -> None:
    """Upload a submission and print its id and page.

    A folder is packed first, the same files always into the same bytes. The actions of a log, from
    `vitac evaluate --log` or the 2025 challenge, are re-simulated; logs are ranked separately from models.

    Exit code 0: accepted (with --watch: completed), 1: refused, 2: wrong usage.
    """
    client = make_client(server, token_file)
    kind = kind or (SubmissionKind.IMAGE if image else find_kind(submission))
    track = track or _find_track(submission, kind)
    note_ignored_folders(submission)
    known: list[bool] = []
    with packed(submission) as archive, upload_bar(archive.stat().st_size, shown=not as_json) as on_position:
        answer = client.upload(
            archive,
            track=track,
            competition=competition,
            kind=kind,
            team=team,
            again=again,
            file_name=submission.resolve().name,
            on_position=on_position,
            on_known=lambda: known.append(True),
        )
    if as_json and not watch:
        print_json(answer)
    if not as_json:
        describe(client, answer, is_known=bool(known))
    if watch:
        show_when_ended(client, answer["id"], as_json=as_json)


def find_kind(path: Path) -> SubmissionKind:
    """Return what a file or folder is; the service checks it anyway."""
    return SubmissionKind.MODEL if path.is_dir() else kind_of_file(path.name)


def _find_track(submission: Path, kind: SubmissionKind) -> str | None:
    """Return the track that a model's manifest or the header of one of our logs names; None of a 2025 text log.

    The service knows which of its tracks a text log is of.
    """
    from vitac.evaluator.logs.log import LogReader, open_log
    from vitac.evaluator.submission.sources import read_manifest_file

    if kind.form.is_archive:
        return read_manifest_file(submission).track
    if not kind.form.is_verified:
        return None
    with open_log(submission) as stream:
        return LogReader(stream).header.manifest.track


@contextmanager
def packed(submission: Path) -> Iterator[Path]:
    """Yield the file to upload: a file unchanged, a folder as a temporary zip."""
    if submission.is_file():
        yield submission
        return
    with tempfile.TemporaryDirectory(prefix="vitac-submit-") as folder:
        archive = Path(folder) / "submission.zip"
        pack(submission, archive)
        yield archive


@contextmanager
def upload_bar(total_bytes: int, *, shown: bool) -> Iterator[Callable[[int], None]]:
    """Show the upload's progress on stderr if it is a terminal."""
    from rich.console import Console
    from rich.progress import BarColumn, DownloadColumn, Progress, TextColumn, TransferSpeedColumn

    console = Console(stderr=True)
    if not shown:
        yield lambda _: None
        return
    columns = (TextColumn("{task.description}"), BarColumn(), DownloadColumn(binary_units=True), TransferSpeedColumn())
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as progress:
        task = progress.add_task("upload", total=total_bytes)

        def show(position: int) -> None:
            progress.update(task, completed=position)
            if position >= total_bytes:
                progress.update(task, description=CHECKING, total=None)  # a bar that moves
                if not console.is_terminal:
                    print(f"vitac: uploaded; {CHECKING}", file=sys.stderr, flush=True)

        yield show


def describe(client: Client, answer: Json, *, is_known: bool) -> None:
    """Print id, state and page of an accepted submission."""
    evaluation = answer["evaluation"]
    print(f"submission  {answer['id']}")
    if answer["log"]:
        print(f"kind        {answer['log']['label']}")
    place = describe_place(evaluation)
    print(f"state       {evaluation['state']}" + (f", {place}" if place else ""))
    if waits := nobody(answer):
        print(f"waits       {waits}")
    if is_known:
        print(
            f"again       you submitted this content on {format_time(answer['submitted_at'])}; {_explain_known(answer)}"
        )
    print(f"tasks       {', '.join(answer['tasks'])}")
    if missing := missing_tasks(answer):
        print(f"not played  {missing}")
    print(f"page        {client.server}/submissions/{answer['id']}")
    print("\nSign in with the same token to see the page. `vitac status ID --watch` shows the progress here.")


def _explain_known(answer: Json) -> str:
    if has_ended(answer):
        return "nothing was started (--again runs it)"
    return "it is evaluated already, and nothing else was started"
