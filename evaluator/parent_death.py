"""Lets a process end with the one that started it, however that ends; called by processes at their start."""

import ctypes
import os
import signal
import sys
from threading import Thread
from time import sleep

_PR_SET_PDEATHSIG = 1
_LOOK_EVERY_S = 1.0


def end_with_parent(parent: int, by: signal.Signals = signal.SIGKILL) -> None:
    """Ask for a signal when the parent ends; exit if it has ended already.

    Linux sends it. Elsewhere a thread looks every second whether the parent is still there.

    Args:
        parent: id of the process that started this one.
        by: the signal.
    """
    if sys.platform != "linux":
        Thread(target=_watch, args=(parent, by), daemon=True).start()
    elif ctypes.CDLL(None, use_errno=True).prctl(_PR_SET_PDEATHSIG, by, 0, 0, 0) != 0:
        raise OSError(ctypes.get_errno(), "prctl(PR_SET_PDEATHSIG) failed")
    if os.getppid() != parent:
        os._exit(1)


def _watch(parent: int, by: signal.Signals) -> None:
    while os.getppid() == parent:
        sleep(_LOOK_EVERY_S)
    os.kill(os.getpid(), by)
