from types import ModuleType
from typing import Any

import numpy as np
import pytest
from example_policies import flow

PULL, LIFT = [-0.75, 0.0], [0.0, -1.0]


EXAMPLE = "lock_opening_heuristic"


def observation(turn_rad: float, seed: int = 0) -> dict[str, Any]:
    """The handle has turned between the gels, which see it from two sides; something else moved the markers too."""
    shift = np.array([[1.5, -2.0], [0.0, 0.0], [0.0, 0.0]])
    turned = 100 * turn_rad * np.array([[0.0, 0.0], [0.0, 1.0], [-1.0, 0.0]])
    sensors = [flow(shift + side * turned, 0.7, seed + side) for side in (-1, 1)] if seed else None
    sensors = sensors or [flow(shift + side * turned) for side in (-1, 1)]
    return {"marker_flow": np.stack(sensors), "relative_motion": np.zeros(3, np.float32)}


def player(policy: ModuleType, env_steps: int = 2) -> Any:
    """A policy that has pressed the teeth against the ceiling."""
    started = policy.Policy()
    started.reset("lock-opening")
    for _ in range(env_steps):
        started.act(observation(0.0))
    return started


@pytest.mark.parametrize("turn_rad", [-0.01, 0.0, 0.004, 0.012])
def test_turn_is_measured_whatever_else_moves_the_markers(policy: ModuleType, turn_rad: float) -> None:
    assert policy.handle_rotation(observation(turn_rad)["marker_flow"]) == pytest.approx(turn_rad, abs=1e-4)


@pytest.mark.parametrize("seed", range(2, 22, 2))
def test_teeth_under_the_ceiling_are_told_from_free_ones_through_the_noise(policy: ModuleType, seed: int) -> None:
    assert player(policy).act(observation(0.010, seed)).tolist() == PULL
    assert player(policy).act(observation(0.000, seed)).tolist() == LIFT


def test_presses_against_the_ceiling_before_it_decides(policy: ModuleType) -> None:
    started = player(policy, env_steps=0)
    lifted_mm = -sum(float(started.act(observation(turn_rad))[1]) for turn_rad in (0.0, 0.02))
    assert lifted_mm == pytest.approx(1.6)
    assert started.act(observation(0.02)).tolist() == PULL


def test_actions_are_float32_within_bounds(policy: ModuleType) -> None:
    started = player(policy, env_steps=0)
    actions = [started.act(observation(turn_rad)) for turn_rad in (0.0, 0.0, 0.012, 0.0)]
    assert {(action.dtype, action.shape) for action in actions} == {(np.dtype(np.float32), (2,))}
    assert np.abs(actions).max() <= 1


def test_reset_begins_anew(policy: ModuleType) -> None:
    used = player(policy, env_steps=5)
    used.reset("lock-opening")
    fresh = player(policy, env_steps=0)
    assert used.act(observation(0.0)).tolist() == fresh.act(observation(0.0)).tolist()
