"""The page of `vitac play` and what it asks for, on this machine only. Called by `command`."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from vitac.evaluator.episodes.records import EpisodeOutcome
from vitac.evaluator.own_page import OwnPageServer, PageFile
from vitac.training.demonstrations.collecting import DemonstrationKind
from vitac.training.demonstrations.hand_play import HandPlay

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
