"""Shows a running evaluation: a progress bar for each task on a terminal, a line every 10 % in a pipe.

Called by `status`, `submit` and `demo`.
"""

from typing import Self

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, SpinnerColumn, TaskID, TextColumn, TimeElapsedColumn

from .http import Json

LINES_PER_EVALUATION = 10


class EvaluationProgress:
    """Progress of one evaluation; `update` is called with each new state of the submission.

    Args:
        quiet: show nothing.
        console: where to show it; default: stderr, so that a pipe receives only the result.
        indent: spaces before each line.
    """

    def __init__(self, *, quiet: bool = False, console: Console | None = None, indent: int = 0) -> None:
        self._quiet = quiet
        self._console = console or Console(stderr=True)
        self._indent = " " * indent
        self._tenths_printed = 0
        self._check: str | None = None
        self._wait = ""
        self._bar: Progress | None = None
        self._tasks: dict[str, TaskID] = {}

    def __enter__(self) -> Self:
        if not self._quiet and self._console.is_terminal:
            self._bar = Progress(
                TextColumn(self._indent.removesuffix(" ")),
                SpinnerColumn(style="cyan"),
                TextColumn("{task.fields[name]}"),
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

    def __exit__(self, *exception: object) -> None:
        if self._bar is not None:
            self._bar.stop()

    def update(self, submission: Json) -> None:
        """Show the current state of a submission."""
        if self._quiet:
            return
        evaluation = submission["evaluation"]
        progress = evaluation["progress"]
        if self._bar is None:
            self._print_check(evaluation.get("sensor_check"))
            self._print_wait(nobody(submission))
            self._print_line(progress)
            return
        tasks = progress["tasks"]
        if not tasks or "" in self._tasks:  # of a sealed list only the sum is known before the end
            tasks = [progress | {"task": ""}]
        several = len(tasks) > 1
        for task in tasks:
            self._update_bar(self._bar, task, name=task["task"] if several else "", description=situation(submission))

    def _update_bar(self, bar: Progress, task: Json, *, name: str, description: str) -> None:
        total, done = task["episodes_total"], task["episodes_done"]
        if task["task"] not in self._tasks:
            self._tasks[task["task"]] = bar.add_task("", total=total, successes=0, name=name)
        shown = description if done < total else ""
        bar.update(self._tasks[task["task"]], completed=done, successes=_shown(task["successes"]), description=shown)

    def _print_check(self, state: str | None) -> None:
        if state != self._check:
            self._check = state
            line = f"sensor check: {state}" if state else "sensor check: over"
            self._console.print(self._indent + line, highlight=False)

    def _print_wait(self, reason: str) -> None:
        """Say once why nothing happens: without a bar, a wait for a worker would be silent and without end."""
        if reason and reason != self._wait:
            self._console.print(f"{self._indent}waiting: {reason}", highlight=False, soft_wrap=True)
        self._wait = reason

    def _print_line(self, progress: Json) -> None:
        done, total = progress["episodes_done"], progress["episodes_total"]
        tenth = LINES_PER_EVALUATION * done // total
        if tenth > self._tenths_printed:
            self._tenths_printed = tenth
            line = f"{self._indent}{done}/{total} episodes, {_shown(progress['successes'])} successes"
            self._console.print(line + _format_tasks(progress["tasks"]), highlight=False, soft_wrap=True)


def _format_tasks(tasks: list[Json]) -> str:
    """Return the progress of each task, where there are several."""
    parts = [f"{task['task']} {task['episodes_done']}/{task['episodes_total']}" for task in tasks]
    return f" ({', '.join(parts)})" if len(parts) > 1 else ""


def nobody(submission: Json) -> str:
    """Return why no worker takes the evaluation now, in a few words; empty where one does or it has ended."""
    if submission.get("waits"):
        return str(submission["waits"])
    if submission["workers"]["alive"] > 0 or submission["evaluation"]["state"] not in {"queued", "running"}:
        return ""
    workers = submission["workers"]
    if family := workers.get("missing_family"):
        return f"no running worker has what {family} needs"
    if workers.get("lacks_gpu"):
        return "no running worker has a GPU, which the image needs"
    if evaluator := workers.get("missing_evaluator"):
        return f"no running worker has evaluator {evaluator}, with which it began"
    return "no worker is running"


def missing_tasks(submission: Json) -> str:
    """Return which tasks a submission does not play and what that means for its rank; empty where it plays all."""
    missing = submission["missing_tasks"]
    if not missing:
        return ""
    counts = len(missing) < len(submission["evaluation"]["counted_tasks"])
    meaning = "counts as 0 % in" if counts else "without it no place in"
    return f"{', '.join(missing)} ({meaning} the ranking of all tasks)"


def describe_place(evaluation: Json) -> str:
    """Return where an evaluation that has not begun stands, in a few words; empty for one that has."""
    if check := evaluation.get("sensor_check"):
        return "its sensor is being checked" if check == "running" else "its sensor waits to be checked"
    return f"number {evaluation['queue_position']} in the queue" if evaluation["queue_position"] else ""


def situation(submission: Json) -> str:
    """Return what the evaluation waits for, or the estimated time left, in a few words."""
    evaluation = submission["evaluation"]
    if waits := nobody(submission):
        return waits
    if place := describe_place(evaluation):
        return place
    eta = evaluation["eta_s"]
    return "" if eta is None else f"about {eta:.0f} s left"


def _shown(successes: int | None) -> object:
    """Return a number of successes, which a sealed list hides before the end."""
    return "hidden" if successes is None else successes
