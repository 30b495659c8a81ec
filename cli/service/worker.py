"""`vitac worker`: evaluates queued submissions."""

import os
import signal
import sys
from typing import Annotated

import typer
from vitac.evaluator.parent_death import end_with_parent

from .database import load_settings
from .durations import parse_duration_s
from .web_server import no_collections


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
