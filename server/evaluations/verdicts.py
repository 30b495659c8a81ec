"""Why an evaluation has no score: the policy's own verdicts and those of the service, each with its sentence."""

from vitac.evaluator.agent.verdicts import VerdictCode
from vitac.evaluator.sentence_enum import SentenceEnum


class ServiceVerdict(SentenceEnum):
    """Ends of an evaluation by the machines, and by what is found against a log or a sensor."""

    MACHINE_FAILED = (
        "machine_failed",
        "The machines that ran this evaluation failed several times; it is not the policy's fault. "
        "Submit it again; if it fails again or is refused, ask the organizers.",
    )
    SENSOR_REJECTED = (
        "sensor_rejected",
        "The sensor breaks a rule. `vitac sensor check` finds the same on your machine; "
        "correct it and submit it again.",
    )
    SENSOR_TOO_SLOW = (
        "sensor_too_slow",
        "Checking and meshing the sensor took longer than a check may; simplify its gel and submit it again.",
    )
    DIVERGED = (
        "diverged",
        "The log's actions lead to other states than it says; it is not ranked. `vitac log verify` shows it locally.",
    )
    OTHER_PICTURE = (
        "other_picture",
        "The log's states are right, but a camera picture that it names is not the one seen there; it is not ranked. "
        "Evaluate again with an unchanged version of vitac and upload the new log.",
    )
    IMPOSSIBLE = (
        "impossible",
        "No evaluation by this evaluator can have made the log; "
        "evaluate again with its version and upload the new log.",
    )


SENSOR_VERDICTS = frozenset({ServiceVerdict.SENSOR_REJECTED, ServiceVerdict.SENSOR_TOO_SLOW})
"""Verdicts before any episode was played."""

REFUTING_RESULTS = frozenset(
    {
        ServiceVerdict.SENSOR_REJECTED,
        ServiceVerdict.DIVERGED,
        ServiceVerdict.OTHER_PICTURE,
        ServiceVerdict.IMPOSSIBLE,
    }
)
"""Verdicts that the same content gets again with the same evaluator."""


def find_sentence(code: str, message: str) -> str:
    """Return the sentence of a stored verdict, given what was said."""
    if code in {verdict.value for verdict in ServiceVerdict}:
        return ServiceVerdict(code).sentence
    return VerdictCode(code).explain(message)
