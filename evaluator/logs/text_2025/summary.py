"""A text log in a few numbers and problems: the JSON of `vitac log import`."""

from ...strict_model import StrictModel
from .checks import check
from .kinds import Kind, kind_of
from .messages import TextLogRejected
from .reader import TextLog


class TextLogSummary(StrictModel):
    """What a log says, what it claims in its last lines, and what is wrong with it."""

    task: str
    track: str
    team: str
    script_md5: str | None
    episodes: int
    successes: int
    success_rate: float
    claimed_success_rate: float | None
    claimed_average_steps: float | None
    problems: tuple[str, ...]


def summarize(log: TextLog) -> tuple[Kind, TextLogSummary]:
    """Return the kind of a log and its summary.

    Raises:
        TextLogRejected: its environment is that of no known kind.
    """
    kind = kind_of(log.environment)
    if kind is None:
        raise TextLogRejected("The environment printed in the header is that of no task of the 2025 challenge.")
    successes = sum(episode.success is True for episode in log.episodes)
    return kind, TextLogSummary(
        task=kind.task,
        track=kind.track,
        team=log.team or "",
        script_md5=log.script_md5,
        episodes=len(log.episodes),
        successes=successes,
        success_rate=successes / len(log.episodes) if log.episodes else 0.0,
        claimed_success_rate=log.claimed_success_rate,
        claimed_average_steps=log.claimed_average_steps,
        problems=(*log.problems, *check(log, kind)),
    )
