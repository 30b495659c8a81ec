"""Shows a running evaluation: a bar on a terminal, a line per tenth in a pipe.

Called by `status`, `submit` and `demo`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Self

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

if TYPE_CHECKING:
    from types import TracebackType

    from rich.progress import TaskID

    from .client import Json

LINES_PER_EVALUATION = 10


class EvaluationProgress:
    """Told each new state of a submission; shows what changed.

    Args:
        quiet: show nothing.
        console: where to show it; default: stderr, so that a pipe gets the result only.
        indent: spaces before each line.
    """

    def __init__(self, *, quiet: bool = False, console: Console | None = None, indent: int = 0) -> None:
        self._quiet = quiet
        self._console = console or Console(stderr=True)
        self._indent = " " * indent
        self._lines_said = 0
        self._bar: Progress | None = None
        self._task: TaskID | None = None

    def __enter__(self) -> Self:
        if not self._quiet and self._console.is_terminal:
            self._bar = Progress(
                TextColumn(self._indent.removesuffix(" ")),
                SpinnerColumn(style="cyan"),
                BarColumn(bar_width=40, complete_style="cyan", finished_style="green"),
                MofNCompleteColumn(),
                TextColumn("[green]{task.fields[successes]}[/green] [dim]successes[/dim]"),
                TimeElapsedColumn(),
                TextColumn("[dim]{task.description}[/dim]"),
                console=self._console,
                transient=True,
            )
            self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._bar is not None:
            self._bar.stop()

    def update(self, found: Json) -> None:
        """Show the present state of a submission."""
        if self._quiet:
            return
        evaluation = found["evaluation"]
        progress = evaluation["progress"]
        if self._bar is None:
            self._say_line(progress)
            return
        total, done = progress["episodes_total"], progress["episodes_done"]
        if self._task is None:
            self._task = self._bar.add_task("", total=total, successes=0)
        self._bar.update(self._task, completed=done, successes=progress["successes"], description=situation(found))

    def _say_line(self, progress: Json) -> None:
        done, total = progress["episodes_done"], progress["episodes_total"]
        tenth = LINES_PER_EVALUATION * done // total
        if tenth > self._lines_said:
            self._lines_said = tenth
            self._console.print(
                f"{self._indent}{done}/{total} episodes, {progress['successes']} successes", highlight=False
            )


def situation(found: Json) -> str:
    """Say in a few words what the evaluation waits for, or how long it still takes."""
    evaluation = found["evaluation"]
    if found["workers"]["alive"] == 0 and evaluation["state"] in {"queued", "running"}:
        return "no worker is alive"
    if evaluation["state"] == "queued":
        return f"number {evaluation['queue_position']} in the queue"
    eta = evaluation["eta_s"]
    return "" if eta is None else f"about {eta:.0f} s left"
