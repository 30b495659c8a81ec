"""What is found about a log: its verification result, why it is impossible, and where it first diverges.

`checks` and `verification` make findings, shards carry them to the service.
"""

from enum import StrEnum

from pydantic import JsonValue

from ..episodes.records import SampledPicture
from ..strict_model import StrictModel

_LONGEST_TEXT = 100


class VerificationResult(StrEnum):
    """The result of checking and re-simulating a log."""

    VERIFIED = "verified"
    """Every state hash is equal."""
    WITHIN_TOLERANCE = "verified within tolerance"
    """Made on another known platform class, or of a task that does not repeat to the last bit; states differ, all
    outcomes and numbers of env steps are equal."""
    DIVERGED = "diverged"
    """The actions lead to other states than the log says."""
    OTHER_PICTURE = "other_picture"
    """All states of an episode are equal, but the pictures of its sampled env step are not."""
    IMPOSSIBLE = "impossible"
    """No evaluation of this list can have made it."""


class ImpossibleReason(StrEnum):
    """Why no evaluation can have made a log; stable codes for the API."""

    OTHER_EVALUATION = "other_evaluation"
    """Made for another track, task or list, or with another version or mesh."""
    OTHER_TASK = "other_task"
    """A record is of another task than the header says."""
    NOT_IN_LIST = "not_in_list"
    """An episode is not in the list."""
    OTHER_START = "other_start"
    """An episode has another start than in the list."""
    TOO_MANY_STEPS = "too_many_steps"
    """An episode has more env steps than the task allows."""
    WRONG_ACTION = "wrong_action"
    """An action has the wrong size or a value outside [-1, 1]."""
    EPISODE_MISSING = "episode_missing"
    """An episode of the list is missing."""
    BROKEN_POLICY = "broken_policy"
    """The policy failed so often that its evaluation would have ended without a score."""


class Impossibility(StrictModel):
    """Why no evaluation can have made a log; `episode` is None where it concerns the whole log."""

    reason: ImpossibleReason
    message: str
    episode: int | None = None


class Divergence(StrictModel):
    """The first env step of the first episode whose state is not the recorded one; env step 0 is the reset."""

    episode: int
    env_step: int
    recorded_state: str | None
    recorded_info: dict[str, JsonValue] | None
    resimulated_state: str | None
    resimulated_info: dict[str, JsonValue] | None


class OtherPicture(StrictModel):
    """An episode whose recorded pictures are not those of its re-simulation; None where there are none."""

    episode: int
    recorded: SampledPicture | None
    resimulated: SampledPicture | None


class LogFinding(StrictModel):
    """Why a log earns no score: it diverged, its pictures are others, or it is impossible."""

    verdict: VerificationResult
    reason: str
    divergence: Divergence | None = None
    other_picture: OtherPicture | None = None
    impossibility: Impossibility | None = None

    @property
    def episode(self) -> int | None:
        """Number of the episode concerned; None for the whole log."""
        about = self.divergence or self.other_picture or self.impossibility
        return about.episode if about else None

    @classmethod
    def diverged(cls, divergence: Divergence) -> "LogFinding":
        """Return the finding that a log's actions lead to other states."""
        reason = f"diverged at episode {divergence.episode}, env step {divergence.env_step}"
        return cls(verdict=VerificationResult.DIVERGED, reason=reason, divergence=divergence)

    @classmethod
    def from_picture(cls, other: OtherPicture) -> "LogFinding":
        """Return the finding that the camera, or the record, was another one."""
        reason = (
            f"episode {other.episode}: expected {_named(other.resimulated)}, got {_named(other.recorded)}. All states "
            "are equal, so the log was made with another camera or renderer, or its pictures were changed; evaluate "
            "again with this version of vitac, unchanged, and upload the new log"
        )
        return cls(verdict=VerificationResult.OTHER_PICTURE, reason=reason, other_picture=other)

    @classmethod
    def impossible(cls, impossibility: Impossibility) -> "LogFinding":
        """Return the finding that no evaluation can have made a log."""
        return cls(verdict=VerificationResult.IMPOSSIBLE, reason=impossibility.message, impossibility=impossibility)


WHY_TOLERATED = "the environment does not repeat to the last bit; all outcomes are equal"
"""Why a log is accepted whose states differ."""


def _named(picture: SampledPicture | None) -> str:
    return f"the pictures {picture.sha256[:12]}… of env step {picture.env_step}" if picture else "no pictures"


def comparable(recorded: JsonValue, ours: JsonValue) -> JsonValue:
    """Return the parts of a recorded value that have the structure of ours; replace all others by None."""
    if isinstance(ours, dict) and isinstance(recorded, dict):
        return {key: comparable(recorded.get(key), value) for key, value in ours.items()}
    if isinstance(ours, list) and isinstance(recorded, list) and len(ours) == len(recorded):
        return [comparable(theirs, value) for theirs, value in zip(recorded, ours, strict=True)]
    if isinstance(recorded, str) and isinstance(ours, str | None):
        return recorded if len(recorded) <= _LONGEST_TEXT and recorded.isprintable() else None
    if isinstance(recorded, bool) or isinstance(ours, bool):
        return recorded if isinstance(recorded, bool) and isinstance(ours, bool) else None
    return recorded if isinstance(recorded, int | float) and isinstance(ours, int | float) else None
