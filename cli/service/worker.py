"""`vitac worker`: evaluates submissions until stopped. `vitac scale` starts and ends such workers on a cluster."""

import os
import re
import signal
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from vitac.evaluator.parent_death import end_with_parent

from ..terminal.output import existing_file, warn
from .database import load_settings, open_service
from .web_server import no_collections

if TYPE_CHECKING:
    from vitac.worker.slurm import Scaling, SlurmScaler


_UNITS_S = {"": 1, "s": 1, "m": 60, "h": 3600, "d": 86400}


def parse_duration_s(text: str) -> float:
    """Return a duration [s].

    Raises:
        BadParameter: it is none.
    """
    match = re.fullmatch(r"(\d+(?:\.\d+)?)([smhd]?)", text.strip())
    if match is None:
        raise typer.BadParameter(f"expected a duration such as 60, 90s, 15m, 4h or 1d, got {text!r}")
    return float(match[1]) * _UNITS_S[match[2]]


def command(
    slots: Annotated[
        int | None, typer.Option(min=1, help="Number of shards to run at once; default: VITAC_WORKER_SLOTS.")
    ] = None,
    gpu: Annotated[
        bool | None, typer.Option("--gpu", help="Play images with `needs: gpu`, too, on this machine's NVIDIA GPU.")
    ] = None,
    once: Annotated[
        bool, typer.Option("--once", help="End after one shard or playback, or if none comes within 10 s.")
    ] = False,
    drain_when_idle: Annotated[
        float | None,
        typer.Option(parser=parse_duration_s, metavar="TIME", help="End after this time without work: 60, 15m."),
    ] = None,
    max_lifetime: Annotated[
        float | None,
        typer.Option(parser=parse_duration_s, metavar="TIME", help="Take no more work after this time, and end: 4h."),
    ] = None,
    parent: Annotated[
        int | None, typer.Option("--end-with", hidden=True, help="End when the process with this id ends.")
    ] = None,
) -> None:
    """Run a worker until Ctrl-C. Run any number, on any machine that reaches database and storage.

    Exit codes: 0 done or stopped; 69 this machine may take no shards (only with one of the three options that end a
    worker; without, it waits); 75 the database is away: try again later; 1 anything else that is wrong.
    """
    from .web_server import configure_events

    if once and (slots or 1) > 1:
        raise typer.BadParameter("expected one slot with --once, which takes one shard", param_hint="--slots")
    settings = load_settings(worker_slots=1 if once else slots, worker_gpu=gpu)
    configure_events(sys.stderr, settings.log_format)
    if parent is not None:
        end_with_parent(parent, signal.SIGTERM)
    with no_collections():
        from vitac.server.database.availability import DatabaseUnreachable
        from vitac.worker.main import ONCE_WAITS_S, Stay, WorkerRefused, run

    idle_s = ONCE_WAITS_S if once and drain_when_idle is None else drain_when_idle
    try:
        run(settings, Stay(runs=1 if once else None, idle_s=idle_s, lifetime_s=max_lifetime))
    except WorkerRefused as error:
        _exit(os.EX_UNAVAILABLE, str(error))
    except DatabaseUnreachable as error:
        _exit(os.EX_TEMPFAIL, str(error))


def _exit(code: int, sentence: str) -> None:
    print(f"vitac: {sentence}", file=sys.stderr)
    sys.exit(code)


LONGEST_PAUSE_S = 600.0


scale_app = typer.Typer(no_args_is_help=True, rich_markup_mode=None)


@scale_app.callback()
def scale() -> None:
    """Start and end workers with the depth of the queue."""


@scale_app.command()
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
