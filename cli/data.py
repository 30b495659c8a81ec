"""`vitac data`: collects demonstrations of an expert, and makes, checks and describes data sets of them."""

import sys
from pathlib import Path
from typing import Annotated

import typer

from .terminal.output import AsJson, print_json, print_table

app = typer.Typer(no_args_is_help=True)

Processes = Annotated[int, typer.Option(min=1, help="Processes that play episodes.")]


@app.command()
def collect(
    out: Annotated[Path, typer.Option("--out", help="Folder; collections in it are continued.")],
    tasks: Annotated[list[str] | None, typer.Argument(help="Tasks, by default all that have an expert.")] = None,
    successes: Annotated[int, typer.Option(min=1, help="Successful demonstrations of each task.")] = 290,
    seed: Annotated[int, typer.Option(min=0, help="Of the starts.")] = 0,
    processes: Processes = 1,
    as_json: AsJson = False,
) -> None:
    """Let an expert that knows the truth play; the same bytes however many processes play, and after any kill.

    Of ten episodes five are its own actions, four have noise from which it recovers, and in one it is misled.
    """
    from vitac.training.demonstrations.collecting import collect as collect_task
    from vitac.training.demonstrations.collecting import count_outcomes, list_tasks

    from .terminal.compiling import compiling_shown

    rows = []
    for task in tasks or list_tasks():
        with compiling_shown(), _Counter(task, successes) as counter:
            path = collect_task(task, out, successes=successes, seed=seed, processes=processes, report=counter.show)
        rows += [{"task": task, **row, "file": str(path)} for row in count_outcomes(path)]
    if as_json:
        print_json({"demonstrations": rows})
    else:
        columns = ("task", "kind", "episodes", "successes", "env steps")
        print_table(columns, [[row[column.replace(" ", "_")] for column in columns] for row in rows], none="none")


class _Counter:
    """A line on a terminal that says how far collecting is."""

    def __init__(self, task: str, successes: int) -> None:
        self._task, self._successes = task, successes

    def __enter__(self) -> "_Counter":
        return self

    def show(self, episodes: int, successes: int) -> None:
        """Show these numbers."""
        if sys.stderr.isatty():
            text = f"{self._task}: {successes} of {self._successes} successes in {episodes} episodes"
            print(f"\r\x1b[K{text}", end="", file=sys.stderr, flush=True)

    def __exit__(self, *_: object) -> None:
        if sys.stderr.isatty():
            print("\r\x1b[K", end="", file=sys.stderr, flush=True)
