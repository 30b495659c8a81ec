"""`vitac admin track`: track files of the organizer's own."""

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer
from vitac.server.competitions.own_tracks import CORES, check_track

from ...terminal.compiling import compiling_shown
from ...terminal.output import AsJson, print_json, print_table

app = typer.Typer(no_args_is_help=True, rich_markup_mode=None)


@app.callback()
def _has_verbs() -> None:
    """Track files of your own."""


@app.command()
def check(
    file: Annotated[Path, typer.Argument(help="The track's file (YAML).", exists=True, dir_okay=False)],
    as_json: AsJson = False,
) -> None:
    """Check a track's file without a service, and measure what an evaluation on it costs; exit code 0 if it is good.

    A few episodes are played: every shape once, and the largest offsets. The policy's own computation is not included.
    """
    with compiling_shown():
        found = check_track(file)
    if as_json:
        print_json(asdict(found))
        return
    print(f"{found.name}: {found.title}; takes {', '.join(found.accepts)}")
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
        for task in found.tasks
    ]
    print_table(columns, rows, none="")
    for task in found.tasks:
        if task.note:
            print(f"{task.task}: not measured, {task.note}")
    print("Put it into the folder that VITAC_TRACKS_DIR names, the same for server and workers, and restart them.")
