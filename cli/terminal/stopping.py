"""Ends long commands in order, by Ctrl-C and by SIGTERM, which `kill`, Slurm and systemd send. Called by them."""

import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType


class Terminated(SystemExit):
    """SIGTERM has arrived; the exit status is that of a process which it has ended."""


@contextmanager
def stopped_by_signals(remedy: str) -> Iterator[None]:
    """Let Ctrl-C and SIGTERM end the body with all that it has started, and say what then.

    Args:
        remedy: how to go on, such as "run the same command to continue from RUN".
    """
    before = signal.signal(signal.SIGTERM, _end)
    try:
        yield
    except (KeyboardInterrupt, Terminated):
        print(f"\nstopped; {remedy}", file=sys.stderr)
        raise
    finally:
        signal.signal(signal.SIGTERM, before)


def _end(number: int, _: FrameType | None) -> None:
    raise Terminated(128 + number)
