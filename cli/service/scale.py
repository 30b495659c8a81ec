"""`vitac scale`: starts and ends workers with the depth of the queue, on machines that a scheduler lends."""

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..terminal.output import existing_file, warn
from .database import load_settings, open_service
from .durations import parse_duration_s

if TYPE_CHECKING:
    from vitac.worker.slurm import Scaling, SlurmScaler

LONGEST_PAUSE_S = 600.0

app = typer.Typer(no_args_is_help=True, rich_markup_mode=None)


@app.callback()
def scale() -> None:
    """Start and end workers with the depth of the queue."""


@app.command()
def slurm(
    script: Annotated[
        Path, typer.Argument(help="Batch script that runs one worker.", callback=existing_file, show_default=False)
    ],
    most: Annotated[int, typer.Option("--most", min=1, help="Jobs that may wait or run at the same time.")],
    slots: Annotated[int, typer.Option(min=1, help="Shards that a job runs at the same time, each on a CPU.")] = 1,
    every: Annotated[
        float, typer.Option(parser=parse_duration_s, metavar="TIME", help="Time between two checks of the queue.")
    ] = 15.0,
    once: Annotated[bool, typer.Option("--once", help="Check once and end, for cron.")] = False,
) -> None:
    """Keep as many Slurm jobs as the queue has work for, until Ctrl-C; run it where jobs are submitted.

    Jobs end by themselves when they are idle (`vitac worker --drain-when-idle`); jobs that wait for a machine and have
    no work left are cancelled. Only your own jobs of the name vitac-worker are counted and cancelled.
    """
    from vitac.worker.slurm import SlurmScaler

    with open_service(load_settings()) as services:
        scaler = SlurmScaler(services=services, script=script, most=most, slots=slots)
        if once:
            _print_scaling(scaler.scale())
        else:
            _scale_until_stopped(scaler, every)


def _scale_until_stopped(scaler: "SlurmScaler", every_s: float) -> None:
    """Scale again and again; jobs that end at once are submitted at ever longer intervals."""
    from vitac.server.database.availability import DatabaseUnreachable
    from vitac.worker.slurm import SlurmError

    last, pause_s = None, every_s
    while True:
        try:
            done = scaler.scale()
        except (SlurmError, DatabaseUnreachable) as error:
            warn(f"{error} The next check is in {pause_s:.0f} s.")
        else:
            ended_at_once = last is not None and last.submitted and not done.running + done.pending
            is_stuck = ended_at_once and last is not None and done.work >= last.work
            pause_s = min(LONGEST_PAUSE_S, 2 * pause_s) if is_stuck else every_s
            if is_stuck:
                warn(f"All jobs ended and no work was done: read their output. The next check is in {pause_s:.0f} s.")
            if done.submitted or done.cancelled:
                _print_scaling(done)
            last = done
        time.sleep(pause_s)


def _print_scaling(done: "Scaling") -> None:
    print(
        f"open work {done.work}; jobs: {done.running} running, {done.pending} waiting, {done.submitted} submitted, "
        f"{done.cancelled} cancelled",
        flush=True,
    )
