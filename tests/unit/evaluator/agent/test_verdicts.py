import pytest
from vitac.envs.errors import VitacError
from vitac.evaluator.agent.verdicts import PolicyFailed, VerdictCode


@pytest.mark.parametrize("code", VerdictCode)
def test_every_verdict_has_a_sentence(code: VerdictCode) -> None:
    assert code.sentence.endswith(".")
    assert len(code.sentence) > 30


def test_sentences_differ() -> None:
    assert len({code.sentence for code in VerdictCode}) == len(VerdictCode)


def test_failure_carries_what_its_team_needs() -> None:
    failure = PolicyFailed(VerdictCode.CRASHED, "act() raised", "Traceback")
    assert isinstance(failure, VitacError)
    assert (failure.verdict, failure.message, failure.output_tail) == (VerdictCode.CRASHED, "act() raised", "Traceback")
    assert str(failure) == "crashed: act() raised"
