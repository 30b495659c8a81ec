"""Lets Ctrl-C and `kill` wait while compiled code runs.

A signal that arrives in compiled code is handled where Numba makes Python objects of its results. What a handler raises
there ends the process with a segmentation fault, or becomes a SystemError (numba 0.68).
"""

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

_SIGNALS = (signal.SIGINT, signal.SIGTERM)
_handlers: dict[signal.Signals, Callable[[int, FrameType | None], Any]] = {}
"""Of the signals that wait, while they do."""
_arrived: set[int] = set()


@contextmanager
def signals_wait() -> Iterator[None]:
    """Call the handlers of signals that arrive in the block after it; also a decorator."""
    if _handlers or threading.current_thread() is not threading.main_thread():  # elsewhere Python calls no handler
        yield
        return
    for number in _SIGNALS:
        handler = signal.getsignal(number)
        if callable(handler):
            _handlers[number] = handler
            signal.signal(number, _note)
    try:
        yield
    finally:
        _act()
        _handlers.clear()
        _deliver()


@contextmanager
def signals_act() -> Iterator[None]:
    """Call handlers at once in this part of a block in which they wait, such as the compilation of a kernel."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    _act()
    _deliver()
    try:
        yield
    finally:
        for number in _handlers:
            signal.signal(number, _note)


def _note(number: int, _: FrameType | None) -> None:
    _arrived.add(number)


def _act() -> None:
    for number, handler in _handlers.items():
        signal.signal(number, handler)


def _deliver() -> None:
    numbers = sorted(_arrived)
    _arrived.clear()
    for number in numbers:
        signal.raise_signal(number)
