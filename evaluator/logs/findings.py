"""What may be said of a log: the verdicts on it, why it cannot be true, and where it first parts from the physics.

`log_checks` and `verification` find it, shards carry it to the service.
"""

from enum import StrEnum

from pydantic import JsonValue

from ..strict_model import StrictModel

_LONGEST_TEXT = 100


class LogVerdict(StrEnum):
    """What re-simulation says of a log."""

    VERIFIED = "verified"
    """Every state hash is equal."""
    WITHIN_TOLERANCE = "verified within tolerance"
    """Made on another class of machines; states differ, all outcomes and numbers of env steps are equal."""
    DIVERGED = "diverged"
    """The actions do not lead where the log says."""
    IMPOSSIBLE = "impossible"
    """No evaluation of this list can have made it."""


class ImpossibleReason(StrEnum):
    """Why no evaluation can have made a log; stable codes for the API."""

    OTHER_EVALUATION = "other_evaluation"
    """Made for another track, task or list, or with another version or mesh."""
    OTHER_TASK = "other_task"
    """A record is of another task than the header says."""
    NOT_IN_LIST = "not_in_list"
    """The list has no such episode."""
    OTHER_START = "other_start"
    """An episode starts elsewhere than in the list."""
    TOO_MANY_STEPS = "too_many_steps"
    """An episode goes on after the task's last env step."""
    WRONG_ACTION = "wrong_action"
    """An action has the wrong size or a component outside -1 and 1."""
    EPISODE_MISSING = "episode_missing"
    """The list is not whole."""
    BROKEN_POLICY = "broken_policy"
    """The policy failed so often that its evaluation would have ended without a score."""


class Impossibility(StrictModel):
    """Why no evaluation can have made a log; `episode` is None where it concerns the whole."""

    reason: ImpossibleReason
    message: str
    episode: int | None = None


class Divergence(StrictModel):
    """The first env step of the first episode whose state is not the recorded one; step 0 is after the reset."""

    episode: int
    env_step: int
    recorded_state: str | None
    recorded_info: dict[str, JsonValue] | None
    resimulated_state: str | None
    resimulated_info: dict[str, JsonValue] | None


class LogFinding(StrictModel):
    """Why a log earns no score: it diverged, or it is impossible."""

    verdict: LogVerdict
    reason: str
    divergence: Divergence | None = None
    impossibility: Impossibility | None = None

    @property
    def episode(self) -> int | None:
        """The episode that it is about, if it is about one."""
        about = self.divergence or self.impossibility
        return about.episode if about else None

    @classmethod
    def diverged(cls, divergence: Divergence) -> "LogFinding":
        """Return the finding that a log's actions lead elsewhere."""
        reason = f"diverged at episode {divergence.episode} env step {divergence.env_step}"
        return cls(verdict=LogVerdict.DIVERGED, reason=reason, divergence=divergence)

    @classmethod
    def impossible(cls, impossibility: Impossibility) -> "LogFinding":
        """Return the finding that no evaluation can have made a log."""
        return cls(verdict=LogVerdict.IMPOSSIBLE, reason=impossibility.message, impossibility=impossibility)


def comparable(recorded: JsonValue, ours: JsonValue) -> JsonValue:
    """Return what of a recorded value has the form of ours; the rest, which could be anything, becomes None."""
    if isinstance(ours, dict) and isinstance(recorded, dict):
        return {key: comparable(recorded.get(key), value) for key, value in ours.items()}
    if isinstance(ours, list) and isinstance(recorded, list) and len(ours) == len(recorded):
        return [comparable(theirs, value) for theirs, value in zip(recorded, ours, strict=True)]
    if isinstance(recorded, str) and isinstance(ours, str | None):
        return recorded if len(recorded) <= _LONGEST_TEXT and recorded.isprintable() else None
    if isinstance(recorded, bool) or isinstance(ours, bool):
        return recorded if isinstance(recorded, bool) and isinstance(ours, bool) else None
    return recorded if isinstance(recorded, int | float) and isinstance(ours, int | float) else None
