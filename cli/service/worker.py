"""`vitac worker`: evaluates what is in the queue."""

import sys
from typing import Annotated

import typer

from .database import load_settings


def command(
    slots: Annotated[
        int | None, typer.Option(min=1, help="Shards at the same time; default: VITAC_WORKER_SLOTS.")
    ] = None,
    parent: Annotated[int | None, typer.Option("--end-with", hidden=True, help="Process id of the starter.")] = None,
) -> None:
    """Run a worker until Ctrl-C. Any number may run, on any machine that reaches the database and the storage."""
    from vitac.worker.main import run

    from .events import write_events_to

    write_events_to(sys.stderr)
    if parent is not None:
        end_with(parent)
    run(load_settings(worker_slots=slots))


def end_with(parent: int) -> None:
    """Ask the kernel for a SIGTERM when the starter dies, however it dies; end now if it is gone already."""
    import ctypes
    import os
    import signal

    set_parent_death_signal = 1
    if ctypes.CDLL(None, use_errno=True).prctl(set_parent_death_signal, signal.SIGTERM, 0, 0, 0) != 0:
        raise OSError(ctypes.get_errno(), "prctl(PR_SET_PDEATHSIG) failed")
    if os.getppid() != parent:
        sys.exit("the process that started this worker is gone")
