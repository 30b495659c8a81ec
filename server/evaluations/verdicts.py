"""Why an evaluation has no score: the policy's own verdicts and those of the service, each with its sentence."""

from enum import StrEnum

from vitac.evaluator.agent.verdicts import VerdictCode


class ServiceVerdict(StrEnum):
    """Ends of an evaluation that are not a policy's fault: those of the machines, and what is found against a log."""

    MACHINE_FAILED = "machine_failed"
    DIVERGED = "diverged"
    OTHER_PICTURE = "other_picture"
    IMPOSSIBLE = "impossible"

    @property
    def sentence(self) -> str:
        """What happened and what to do about it."""
        return _SENTENCES[self]


_SENTENCES = {
    ServiceVerdict.MACHINE_FAILED: (
        "The machines that ran this evaluation failed several times; it is not the policy's fault. "
        "Submit it again; if it fails again or is refused, ask the organizers."
    ),
    ServiceVerdict.DIVERGED: (
        "The log's actions lead to other states than it says; it is not ranked. `vitac log verify` shows it locally."
    ),
    ServiceVerdict.OTHER_PICTURE: (
        "The log's states are right, but a camera picture that it names is not the one seen there; it is not ranked. "
        "Evaluate again with an unchanged version of vitac and upload the new log."
    ),
    ServiceVerdict.IMPOSSIBLE: (
        "No evaluation by this evaluator can have made the log; evaluate again with its version and upload the new log."
    ),
}


REFUTING_RESULTS = frozenset({ServiceVerdict.DIVERGED, ServiceVerdict.OTHER_PICTURE, ServiceVerdict.IMPOSSIBLE})


def find_sentence(code: str) -> str:
    """Return the sentence of a stored verdict."""
    if code in {verdict.value for verdict in ServiceVerdict}:
        return ServiceVerdict(code).sentence
    return VerdictCode(code).sentence
