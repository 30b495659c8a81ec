"""`vitac worker`: evaluates queued submissions."""

import sys
from typing import Annotated

import typer

from .database import load_settings
from .loading import no_collections


def command(
    slots: Annotated[
        int | None, typer.Option(min=1, help="Number of shards to run at once; default: VITAC_WORKER_SLOTS.")
    ] = None,
    parent: Annotated[
        int | None, typer.Option("--end-with", hidden=True, help="Process id of the parent to end with.")
    ] = None,
) -> None:
    """Run a worker until Ctrl-C. Run any number, on any machine that reaches database and storage."""
    from .events import configure_events

    with no_collections():
        from vitac.worker.main import run

    settings = load_settings(worker_slots=slots)
    configure_events(sys.stderr, settings.log_format)
    if parent is not None:
        exit_with_parent(parent)
    run(settings)


def exit_with_parent(parent: int) -> None:
    """Have the kernel send SIGTERM when the parent ends for any reason; exit if it has ended already."""
    import ctypes
    import os
    import signal

    set_parent_death_signal = 1
    if ctypes.CDLL(None, use_errno=True).prctl(set_parent_death_signal, signal.SIGTERM, 0, 0, 0) != 0:
        raise OSError(ctypes.get_errno(), "prctl(PR_SET_PDEATHSIG) failed")
    if os.getppid() != parent:
        sys.exit("the process that started this worker has ended")
