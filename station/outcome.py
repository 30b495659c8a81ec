"""How a trial can end, and which ends are repeated."""

from typing import Final

from vitac.evaluator.sentence_enum import SentenceEnum


class TrialOutcome(SentenceEnum):
    """How an attempt at a trial ended. The first five are the policy's and count; after the others it is repeated."""

    SUCCESS = "success", "The peg is in its hole, or the lock is open, as gels and encoders say."
    STEPS = "steps", "All env steps were used up."
    TACTILE = "tactile", "A marker moved beyond its limit, or that of force or torque stopped the policy twice."
    ERROR = "error", "An action led out of the range of offsets; nothing moved."
    POLICY_FAILED = "policy_failed", "The policy crashed, broke a limit or answered wrongly; nothing moved."
    NOT_BLOCKED = "not_blocked", "The descent met no plate, so no start was blocked."
    NO_PEG = "no_peg", "The gripper holds no peg or key, or lost it."
    STOPPED = "stopped", "A limit of the station was passed and everything stopped."
    DEVICE_FAULT = "device_fault", "A device did not answer or reported a fault."
    REFUSED = "refused", "The station was not ready."

    @property
    def counts(self) -> bool:
        """Whether it is a result of the policy."""
        return self in _COUNTED


ATTEMPTS: Final = 3
"""Maximum attempts at a trial. If none of them counts, the trial has no result and the evaluation has no score."""
_COUNTED: Final = frozenset(
    {
        TrialOutcome.SUCCESS,
        TrialOutcome.STEPS,
        TrialOutcome.TACTILE,
        TrialOutcome.ERROR,
        TrialOutcome.POLICY_FAILED,
    }
)
