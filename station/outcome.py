"""How a trial can end, and which ends are repeated."""

from enum import StrEnum
from typing import Final


class TrialOutcome(StrEnum):
    """How an attempt at a trial ended. The first five are the policy's and count; after the others it is repeated."""

    SUCCESS = "success"
    STEPS = "steps"
    TACTILE = "tactile"
    ERROR = "error"
    POLICY_FAILED = "policy_failed"
    NOT_BLOCKED = "not_blocked"
    NO_PEG = "no_peg"
    STOPPED = "stopped"
    DEVICE_FAULT = "device_fault"
    REFUSED = "refused"

    @property
    def counts(self) -> bool:
        """Whether it is a result of the policy."""
        return self in _COUNTED

    @property
    def sentence(self) -> str:
        """Its meaning."""
        return _SENTENCES[self]


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
_SENTENCES: Final = {
    TrialOutcome.SUCCESS: "The peg is in its hole, or the lock is open, as gels and encoders say.",
    TrialOutcome.STEPS: "All env steps were used up.",
    TrialOutcome.TACTILE: "A marker moved beyond its limit, or that of force or torque stopped the policy twice.",
    TrialOutcome.ERROR: "An action led out of the range of offsets; nothing moved.",
    TrialOutcome.POLICY_FAILED: "The policy crashed, broke a limit or answered wrongly; nothing moved.",
    TrialOutcome.NOT_BLOCKED: "The descent met no plate, so no start was blocked.",
    TrialOutcome.NO_PEG: "The gripper holds no peg, or lost it.",
    TrialOutcome.STOPPED: "A limit of the station was passed and everything stopped.",
    TrialOutcome.DEVICE_FAULT: "A device did not answer or reported a fault.",
    TrialOutcome.REFUSED: "The station was not ready.",
}
