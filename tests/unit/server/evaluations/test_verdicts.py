import hashlib

import pytest
from vitac.evaluator.agent.verdicts import VerdictCode
from vitac.server.evaluations.scores import combine_hashes
from vitac.server.evaluations.verdicts import ServiceVerdict, find_sentence


@pytest.mark.parametrize("code", [*VerdictCode, *ServiceVerdict])
def test_every_verdict_has_a_sentence(code: VerdictCode | ServiceVerdict) -> None:
    assert find_sentence(code.value, "").endswith(".")


def test_codes_of_service_and_policy_are_different() -> None:
    assert not {code.value for code in ServiceVerdict} & {code.value for code in VerdictCode}


def test_hash_of_one_task_is_the_tasks_own() -> None:
    assert combine_hashes({"peg-insertion": "a" * 64}) == "a" * 64


def test_hash_of_several_tasks_does_not_depend_on_their_order() -> None:
    forward, backward = {"a": "1" * 64, "b": "2" * 64}, {"b": "2" * 64, "a": "1" * 64}
    expected = hashlib.sha256(f"a {'1' * 64}\nb {'2' * 64}\n".encode()).hexdigest()
    assert combine_hashes(forward) == combine_hashes(backward) == expected
