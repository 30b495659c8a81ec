"""Shows on stderr how far compiling the physics is, here or in a process of ours; called where episodes are played."""

from __future__ import annotations

import logging
import sys
import threading
from contextlib import contextmanager
from typing import TYPE_CHECKING, Protocol

from vitac.envs.kernel_cache import STARTED_LOG, CompileProgress, shared_directory

if TYPE_CHECKING:
    from collections.abc import Iterator

    from rich.progress import Progress, TaskID

_POLL_S = 0.2
# Between two kernels nothing is compiled for a moment, so the end is shown after this number of polls without one.
_QUIET_POLLS = 5
_WHAT = "compiling the physics"
ONCE = (
    f"for Python {sys.version_info.major}.{sys.version_info.minor}, once for each version: "
    "half a minute, with busy cores two or three"
)


class Display(Protocol):
    """Where progress is shown."""

    def show(self, progress: CompileProgress) -> None:
        """Show how far compiling is."""

    def end(self) -> None:
        """Show that compiling is over; called after `show` only."""


@contextmanager
def compiling_shown(bar: Progress | None = None) -> Iterator[None]:
    """Show while the body runs when the physics is compiled and how far it is; nothing where it is in the cache.

    Args:
        bar: the command's own progress bar, which gets a line more; without one, a bar appears while it is compiled.
            Where stderr is no terminal, a line is written at the start and one at the end.
    """
    folder = shared_directory()
    if folder is None:
        yield
        return
    display: Display = _Bar(bar) if sys.stderr.isatty() else _Lines()
    ended = threading.Event()

    def watch() -> None:
        quiet_polls = _QUIET_POLLS
        while not ended.wait(_POLL_S):
            progress = CompileProgress.read_own_processes(folder)
            if progress:
                quiet_polls = 0
                display.show(progress)
            elif quiet_polls < _QUIET_POLLS:
                quiet_polls += 1
                if quiet_polls == _QUIET_POLLS:
                    display.end()
        if quiet_polls < _QUIET_POLLS:
            display.end()

    thread = threading.Thread(target=watch, name=_WHAT, daemon=True)
    thread.start()
    announcing = logging.getLogger(STARTED_LOG)
    announcing.disabled = True
    try:
        yield
    finally:
        announcing.disabled = False
        ended.set()
        thread.join()


class _Lines:
    """A line at the start and one at the end, for pipes and files."""

    def __init__(self) -> None:
        self._is_shown = False

    def show(self, _: CompileProgress) -> None:
        if not self._is_shown:
            self._is_shown = True
            print(f"vitac: {_WHAT} {ONCE}", file=sys.stderr, flush=True)

    def end(self) -> None:
        self._is_shown = False
        print("vitac: compiled the physics", file=sys.stderr, flush=True)


class _Bar:
    """A line of a progress bar."""

    def __init__(self, bar: Progress | None) -> None:
        self._is_own = bar is None
        self._bar = bar
        self._line: TaskID | None = None

    def show(self, progress: CompileProgress) -> None:
        if self._bar is None:
            self._bar = _own_bar()
        if self._line is None:
            self._line = self._bar.add_task(f"{_WHAT} {ONCE}", total=None)
        if self._is_own:
            self._bar.start()
        self._bar.update(self._line, completed=progress.compiled, total=progress.kernels)

    def end(self) -> None:
        if self._bar is not None and self._line is not None:
            self._bar.remove_task(self._line)
            self._line = None
            if self._is_own:
                self._bar.stop()


def _own_bar() -> Progress:
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        console=Console(file=sys.stderr),
        transient=True,
    )
