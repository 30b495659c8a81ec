"""Why an evaluation has no score: the policy's own verdicts and those of the service, each with its sentence."""

from enum import StrEnum

from vitac.evaluator.agent.verdicts import VerdictCode


class ServiceVerdict(StrEnum):
    """Ends of an evaluation that are not the policy's fault."""

    MACHINE_FAILED = "machine_failed"

    @property
    def sentence(self) -> str:
        """What happened and what to do about it."""
        return (
            "The machines that ran this evaluation failed several times; it is not the policy's fault. "
            "Submit it again or ask the organizers."
        )


def sentence_of(code: str) -> str:
    """The sentence of a stored verdict."""
    if code in {verdict.value for verdict in ServiceVerdict}:
        return ServiceVerdict(code).sentence
    return VerdictCode(code).sentence
