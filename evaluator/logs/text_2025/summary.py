"""Summarises a 2025 text log in a few numbers and its problems: the JSON of `vitac log import`."""

from typing import Final

from ...strict_model import StrictModel
from .checks import check, hole_top
from .messages import TextLogRejected
from .reader import TextLog
from .scripts import Script, find_script

WHY_RATES_DIFFER: Final = (
    "Claimed and re-simulated rate differ systematically: in the 2025 simulator the same actions lead to other states, "
    "from the first env step on. That it stops after 5 Newton iterations explains about a quarter of it."
)


class TextLogSummary(StrictModel):
    """What a log says, what it claims in its last lines, and what is wrong with it."""

    task: str
    track: str
    team: str
    script_md5: str | None
    era: str | None = None
    """Which books it was made with, where there have been several, recognised from its numbers."""
    episodes: int
    successes: int
    success_rate: float
    claimed_success_rate: float | None
    claimed_average_steps: float | None
    problems: tuple[str, ...]


def summarize(log: TextLog) -> tuple[Script, TextLogSummary]:
    """Return the script that wrote a log, and the log's summary.

    Raises:
        TextLogRejected: its environment is not that of any known script.
    """
    script = find_script(log.environment)
    if script is None:
        raise TextLogRejected("The environment in the header is not that of any task of the 2025 challenge.")
    successes = sum(episode.success is True for episode in log.episodes)
    return script, TextLogSummary(
        task=script.task,
        track=script.track,
        team=log.team or "",
        script_md5=log.script_md5,
        era=script.era(hole_top(log, script)),
        episodes=len(log.episodes),
        successes=successes,
        success_rate=successes / len(log.episodes) if log.episodes else 0.0,
        claimed_success_rate=log.claimed_success_rate,
        claimed_average_steps=log.claimed_average_steps,
        problems=(*log.problems, *check(log, script)),
    )
