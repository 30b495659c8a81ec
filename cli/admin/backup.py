"""`vitac admin backup` and `vitac admin restore`: the whole service in one file."""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import Progress
from vitac.server.operations import backup
from vitac.server.operations import restore as restoring
from vitac.server.operations.archive import BackupDescription

from ..service.database import load_settings, open_service
from ..terminal.output import AsJson, print_record
from .consent import NOTHING_CHANGED, DryRun, Yes, require_consent

RESTART = "Restart servers that are running: they know only the track files that were there when they started."


def back_up(
    file: Annotated[Path, typer.Argument(help="File to write; must not exist.")],
    as_json: AsJson = False,
) -> None:
    """Write database and uploads to one file, while the service runs."""
    with open_service(load_settings()) as services, _progress() as report_file:
        description = backup.back_up(services, file, report_file=report_file)
    _print(file, description, as_json=as_json)


def restore(
    file: Annotated[Path, typer.Argument(help="File that `vitac admin backup` wrote.", exists=True, dir_okay=False)],
    yes: Yes = False,
    dry_run: DryRun = False,
    as_json: AsJson = False,
) -> None:
    """Restore a backup into an empty service; stop its workers first, and restart its servers afterwards."""
    if dry_run:
        with open_service(load_settings()) as services:
            description = restoring.check(services, file)
        print(NOTHING_CHANGED, file=sys.stderr)
    else:
        require_consent(f"Replace the empty database by the one in {file}?", yes=yes)
        with open_service(load_settings()) as services, _progress() as report_file:
            description = restoring.restore(services, file, report_file=report_file)
        if description.track_files:
            print(RESTART, file=sys.stderr)
    _print(file, description, as_json=as_json)


@contextmanager
def _progress() -> Iterator[Callable[[int, int], None]]:
    """Show a bar over the uploaded files on a terminal."""
    with Progress(console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("uploads", total=None)

        def report_file(done: int, total: int) -> None:
            bar.update(task, completed=done, total=total)

        yield report_file


def _print(file: Path, description: "BackupDescription", *, as_json: bool) -> None:
    shown = {
        "file": str(file),
        "made_at": description.made_at.isoformat(timespec="seconds"),
        "release": description.release,
        "schema_revision": description.schema_revision,
        "uploads": len(description.blobs),
        "bytes": file.stat().st_size,
    }
    print_record(shown, as_json=as_json)
