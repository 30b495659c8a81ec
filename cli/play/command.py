"""`vitac play`: plays a task by hand, and stores what was played as demonstrations."""

import webbrowser
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..terminal.compiling import compiling_shown
from ..terminal.output import AsJson, percent, print_json
from ..terminal.stopping import Terminated, stopped_by_signals

if TYPE_CHECKING:
    from vitac.training.demonstrations.hand_play import HandPlay


def command(
    task: Annotated[str, typer.Argument(help="Task, such as peg-insertion.")],
    out: Annotated[Path, typer.Option("--out", help="Folder; demonstrations in it are continued.")] = Path("by_hand"),
    seed: Annotated[int, typer.Option(min=0, help="Of the starts, which are in no official list.")] = 0,
    port: Annotated[int, typer.Option(min=0, max=65535, help="Of the page; 0 for any that is free.")] = 0,
    browser: Annotated[bool, typer.Option(help="Open the page in a browser.")] = True,
    as_json: AsJson = False,
) -> None:
    """Play a task by hand on a page of this machine, with keyboard or game pad, until Ctrl-C.

    It shows what a policy feels: how the markers of both gels have moved. Each episode is stored for `vitac data`.
    """
    from vitac.training.demonstrations.hand_play import HandPlay

    from .server import PlayServer

    with ExitStack() as stack:
        with compiling_shown():
            played = HandPlay(task, out, seed=seed)
            path = stack.enter_context(played.storing())
        server = stack.enter_context(PlayServer(played, port))
        stack.enter_context(suppress(KeyboardInterrupt, Terminated))
        stack.enter_context(stopped_by_signals(f"demonstrations are in {path}"))
        typer.echo(f"Play at {server.address} until Ctrl-C.", err=True)
        if browser:
            webbrowser.open(server.address)
        server.serve_forever()
    _print_rate(played, path, as_json=as_json)


def _print_rate(played: "HandPlay", path: Path, *, as_json: bool) -> None:
    """Print what was solved by marker flow alone, with its interval."""
    from vitac.evaluator.scoring.score import rate
    from vitac.training.demonstrations.collecting import DemonstrationKind

    felt = [each.is_success for each in played.stored if each.kind is DemonstrationKind.HUMAN]
    counted = rate(sum(felt), len(felt)) if felt else None
    if as_json:
        low_high = None if counted is None else (counted.interval.low, counted.interval.high)
        solved = {"task": played.task.name, "episodes": len(felt), "successes": sum(felt), "interval": low_high}
        print_json({**solved, "file": str(path)})
    elif counted is None:
        print("No episode was played by marker flow alone.")
    else:
        interval = f"{percent(counted.interval.low)} to {percent(counted.interval.high)}"
        print(f"human, by marker flow alone: {sum(felt)} of {len(felt)}, {percent(counted.success_rate)} ({interval})")
