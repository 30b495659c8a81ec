from typing import Any

import numpy as np
import pytest
from vitac.evaluator.agent.protocol import checked_action, checked_belief
from vitac.evaluator.agent.verdicts import PolicyFailed, VerdictCode


def verdict(arrays: dict[str, Any]) -> VerdictCode:
    with pytest.raises(PolicyFailed) as caught:
        checked_action(arrays, (3,))
    return caught.value.verdict


@pytest.mark.parametrize("dtype", ["f4", "f8", "i4", "i8", "u1"])
def test_numbers_become_float32(dtype: str) -> None:
    action = checked_action({"action": np.array([1, 0, 2], dtype=dtype)}, (3,))
    assert action.dtype == np.float32
    assert action.tolist() == [1, 0, 2]


def test_action_is_not_clipped() -> None:
    assert checked_action({"action": np.array([5.0, -7.0, 0.0])}, (3,)).tolist() == [5, -7, 0]


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e39, -1e300])
def test_non_finite_numbers_are_named(value: float) -> None:
    assert verdict({"action": np.array([0, value, 0], dtype="f8")}) is VerdictCode.NON_FINITE_ACTION


@pytest.mark.parametrize("shape", [(), (2,), (4,), (1, 3), (3, 1), (0,)])
def test_wrong_shapes_are_named(shape: tuple[int, ...]) -> None:
    assert verdict({"action": np.zeros(shape, dtype="f4")}) is VerdictCode.BAD_ACTION_SHAPE


def test_truth_values_are_no_action() -> None:
    assert verdict({"action": np.zeros(3, dtype="?")}) is VerdictCode.BAD_ACTION_TYPE


@pytest.mark.parametrize("names", [(), ("other",), ("action", "more")])
def test_other_arrays_are_a_violation(names: tuple[str, ...]) -> None:
    assert verdict({name: np.zeros(3) for name in names}) is VerdictCode.PROTOCOL_VIOLATION


def test_a_belief_is_checked_as_an_action_is_and_may_be_missing() -> None:
    assert checked_belief({}, (3,)) is None
    believed = checked_belief({"belief": np.array([30.0, -2, 0])}, (3,))
    assert believed is not None
    assert believed.dtype == np.float32
    assert believed.tolist() == [30.0, -2.0, 0.0]


@pytest.mark.parametrize(
    ("arrays", "code", "message"),
    [
        ({"action": np.zeros(3)}, VerdictCode.PROTOCOL_VIOLATION, "expected 'belief' alone"),
        ({"belief": np.zeros(2)}, VerdictCode.BAD_ACTION_SHAPE, r"Belief has shape \(2,\), expected \(3,\)"),
        ({"belief": np.array([0, np.nan, 0])}, VerdictCode.NON_FINITE_ACTION, "Belief is"),
        ({"belief": np.zeros(3, dtype="?")}, VerdictCode.BAD_ACTION_TYPE, "Belief has dtype bool"),
    ],
)
def test_a_wrong_belief_is_named(arrays: dict[str, Any], code: VerdictCode, message: str) -> None:
    with pytest.raises(PolicyFailed, match=message) as caught:
        checked_belief(arrays, (3,))
    assert caught.value.verdict is code
