from typing import Any

import numpy as np
import pytest
from vitac.evaluator.agent.protocol.action import checked_action
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
