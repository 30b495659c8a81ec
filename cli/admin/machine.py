"""Verbs of `vitac admin` that need this machine: its database and files, or its simulation."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..client.verbs import NOTHING_CHANGED, DryRun, Yes, require_consent
from ..terminal.output import AsJson, print_json, print_record, print_table

if TYPE_CHECKING:
    from vitac.server.operations.backup import BackupDescription

RESTART = "Restart servers that are running: they know only the track files that were there when they started."


def back_up(
    file: Annotated[Path, typer.Argument(help="File to write; must not exist.")],
    as_json: AsJson = False,
) -> None:
    """Write database and uploads to one file, while the service runs."""
    from vitac.server.operations import backup

    from ..service.database import load_settings, open_service

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
    from vitac.server.operations import backup as restoring

    from ..service.database import load_settings, open_service

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
    from rich.console import Console
    from rich.progress import Progress

    with Progress(console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("uploads", total=None)

        def report_file(done: int, total: int) -> None:
            bar.update(task, completed=done, total=total)

        yield report_file


def _print(file: Path, description: BackupDescription, *, as_json: bool) -> None:
    shown = {
        "file": str(file),
        "made_at": description.made_at.isoformat(timespec="seconds"),
        "release": description.release,
        "schema_revision": description.schema_revision,
        "uploads": len(description.blobs),
        "bytes": file.stat().st_size,
    }
    print_record(shown, as_json=as_json)


def check_track(
    file: Annotated[Path, typer.Argument(help="The track's file (YAML).", exists=True, dir_okay=False)],
    as_json: AsJson = False,
) -> None:
    """Check a track's file without a service, and measure what an evaluation on it costs; exit code 0 if it is good.

    A few episodes are played: every shape once, and the largest offsets. The policy's own computation is not included.
    """
    from vitac.server.competitions.own_tracks import CORES
    from vitac.server.competitions.own_tracks import check_track as check

    from ..terminal.compiling import compiling_shown

    with compiling_shown():
        checked = check(file)
    if as_json:
        print_json(asdict(checked))
        return
    print(f"{checked.name}: {checked.title}; takes {', '.join(checked.accepts)}")
    columns = ("task", "episodes", "shapes", "list", "shards", "CPU s an episode", "CPU s", f"wall s, {CORES} cores")
    rows = [
        [
            task.task,
            task.episodes,
            ", ".join(task.shapes),
            task.list_kind.value,
            task.shards,
            None if task.cpu_s_per_episode is None else round(task.cpu_s_per_episode, 3),
            task.cpu_s,
            task.wall_s,
        ]
        for task in checked.tasks
    ]
    print_table(columns, rows, none="")
    for task in checked.tasks:
        if task.note:
            print(f"{task.task}: not measured, {task.note}")
    print("Put it into the folder that VITAC_TRACKS_DIR names, the same for server and workers, and restart them.")


def replay(
    appeal: Annotated[int, typer.Argument(min=1, max=2_147_483_647, help="Number of the appeal.")],
    task: Annotated[str, typer.Argument(help="Task of the episode.")],
    episode: Annotated[int, typer.Argument(min=1, max=2_147_483_647, help="Number of the episode.")],
    corrected: Annotated[
        Path | None, typer.Option(exists=True, dir_okay=False, help="Zip with another policy than the submission's.")
    ] = None,
    dry_run: DryRun = False,
    yes: Yes = False,  # noqa: ARG001 - nobody is asked
    as_json: AsJson = False,
) -> None:
    """Have a worker play an episode again; the stored result and the boards stay as they are."""
    from vitac.server.principals import CONSOLE
    from vitac.server.queue.workers import workers_alive
    from vitac.server.submissions import appeal_replays
    from vitac.server.views.correspondence import AppealReplayView

    from ..service.database import load_settings, open_service

    with open_service(load_settings()) as services:
        database = services.database.make_trial() if dry_run else services.database
        with database.transaction() as session:
            replay = appeal_replays.ask(
                session, services.blobs, CONSOLE, appeal, task=task, episode=episode, corrected=corrected
            )
            played = {name: getattr(replay, name) for name in AppealReplayView.model_fields}
            workers = workers_alive(session, services.settings)
        if dry_run:
            print(NOTHING_CHANGED, file=sys.stderr)
        else:
            says = "A worker plays the episode." if workers.alive else "No worker is running; start one: vitac worker."
            print(says, file=sys.stderr)
            played = appeal_replays.wait(services, replay.id).model_dump()
    print_record(played, as_json=as_json)
