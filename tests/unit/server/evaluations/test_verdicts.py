import pytest
from vitac.evaluator.agent.verdicts import VerdictCode
from vitac.server.evaluations.verdicts import ServiceVerdict, find_sentence


@pytest.mark.parametrize("code", [*VerdictCode, *ServiceVerdict])
def test_every_verdict_has_a_sentence(code: VerdictCode | ServiceVerdict) -> None:
    assert find_sentence(code.value, "").endswith(".")


def test_codes_of_service_and_policy_are_different() -> None:
    assert not {code.value for code in ServiceVerdict} & {code.value for code in VerdictCode}
