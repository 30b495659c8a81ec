"""`vitac play`: a page of this machine on which somebody plays a task by hand."""

import webbrowser
from collections.abc import Mapping
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer
from vitac.evaluator.episodes.records import EpisodeOutcome
from vitac.evaluator.own_page import OwnPageServer, PageFile
from vitac.training.demonstrations.collecting import DemonstrationKind
from vitac.training.demonstrations.hand_play import HandPlay

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


PAGE_FILES: Final = {
    "": PageFile(Path(__file__).with_name("page.html"), "text/html"),
    "page.js": PageFile(Path(__file__).with_name("page.js"), "text/javascript"),
}


class PlayServer(OwnPageServer):
    """Serves one person.

    Args:
        played: the task.
        port: 0 for any that is free.
    """

    def __init__(self, played: HandPlay, port: int = 0) -> None:
        super().__init__(PAGE_FILES, port)
        self.played = played

    def answer(self, asked: str, content: Mapping[str, Any]) -> dict[str, Any]:
        """Play what the page asks for, and return what it shows."""
        return answer(self.played, asked, content)


def answer(played: HandPlay, asked: str, content: Mapping[str, Any]) -> dict[str, Any]:
    """Return the answer to a request of the page.

    Raises:
        NotPlayedByHand: an action does not fit.
        ValueError: something else is asked for.
    """
    if asked == "step":
        played.step(content["action"])
    elif asked == "next":
        played.begin()
    elif asked == "scene":
        return {**played.scene_mm(), "limits_mm": played.perspective.section.limits_mm}
    elif asked != "state":
        raise ValueError(f"There is no {asked!r:.40}; expected state, step, next or scene.")
    return describe_state(played)


def describe_state(played: HandPlay) -> dict[str, Any]:
    """Return what is shown of the running episode."""
    end = played.end_reason
    felt = [each for each in played.stored if each.kind is DemonstrationKind.HUMAN]
    return {
        "title": played.task.title,
        "actions": [{"name": each.name, "meaning": each.meaning} for each in played.task.actions],
        "control_rate_hz": played.control_rate_hz,
        "episode": played.number,
        "env_step": played.env_steps,
        "max_steps": played.task.max_steps,
        "motion": played.motion,
        "markers_px": played.markers_px,
        "end": None if end is None else EpisodeOutcome(end).sentence,
        "is_success": end == EpisodeOutcome.SUCCESS,
        "played": len(felt),
        "solved": sum(each.is_success for each in felt),
    }
