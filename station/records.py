"""The stored record of a trial on a station: all its attempts, of which at most the last one counts."""

from typing import Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, NonNegativeFloat, PositiveInt
from vitac.evaluator.episodes.records import ActionSequence
from vitac.evaluator.strict_model import StrictModel, Word
from vitac.evaluator.tracks import Episode

from .outcome import TrialOutcome
from .trial import Attempt

Pair = tuple[float, float]


def pack_actions(attempt: Attempt) -> NDArray[np.float32]:
    """Return the actions of an attempt, shape [env steps, numbers of an action]."""
    return np.array(attempt.actions, dtype=np.float32).reshape(len(attempt.actions), attempt.action_numbers)


class AttemptRecord(StrictModel):
    """One attempt at a trial; `encoders` and `movement_px` have an entry after the start and after each env step."""

    outcome: TrialOutcome
    reason: str = ""
    actions: ActionSequence
    encoders: tuple[tuple[float, float, float, float], ...] = ()
    """Pose of the stage: x, y, z [mm], rotation [deg]."""
    movement_px: tuple[Pair, ...] = ()
    """Mean movement of the markers of the left and the right gel."""
    thresholds_px: Pair
    """Movement of both gels that is more than noise."""
    policy_s: NonNegativeFloat
    output: str = ""

    @classmethod
    def from_attempt(cls, attempt: Attempt) -> Self:
        """Return the record of an attempt."""
        return cls(
            outcome=attempt.outcome,
            reason=attempt.reason,
            actions=ActionSequence.from_array(pack_actions(attempt)),
            encoders=tuple(attempt.encoders),
            movement_px=tuple(attempt.movement_px),
            thresholds_px=attempt.thresholds_px,
            policy_s=attempt.policy_s,
            output=attempt.output,
        )


class TrialRecord(StrictModel):
    """One trial. It has a result only if its last attempt counts."""

    episode: PositiveInt
    shape: Word
    offset: tuple[float, ...]
    attempts: tuple[AttemptRecord, ...] = Field(min_length=1)

    @property
    def outcome(self) -> TrialOutcome:
        """How the last attempt ended."""
        return self.attempts[-1].outcome

    @classmethod
    def from_attempts(cls, episode: Episode, attempts: list[Attempt]) -> Self:
        """Return the record of a trial."""
        return cls(
            episode=episode.number,
            shape=episode.shape,
            offset=episode.offset,
            attempts=tuple(AttemptRecord.from_attempt(each) for each in attempts),
        )
