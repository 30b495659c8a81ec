"""The example policy of ManiSkill's PickCube-v1."""

from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from example_policies import imported
from vitac.envs.tasks.definition import Family
from vitac.evaluator.tracks import load_track


@pytest.fixture(scope="module")
def policy(repository: Path) -> Iterator[SimpleNamespace]:
    with imported(repository / "examples/maniskill/ManiSkill") as modules:
        yield modules.policy


def state(policy: SimpleNamespace, *, to_cube: list[float], to_goal: list[float], grasped: bool = False) -> np.ndarray:
    values = np.zeros(42, np.float32)
    values[policy.IS_GRASPED] = grasped
    values[policy.TCP_TO_CUBE], values[policy.CUBE_TO_GOAL] = to_cube, to_goal
    return values


@pytest.mark.parametrize(
    ("to_cube", "grasped", "expected"),
    [
        ([0.05, 0.0, -0.1], False, [0.5, 0.0, -0.4, 1.0]),  # above it first, open
        ([0.0, 0.01, -0.05], False, [0.0, 0.1, -0.5, 1.0]),  # straight down
        ([0.0, 0.0, -0.01], False, [0.0, 0.0, 0.0, -1.0]),  # close on it
        ([0.0, 0.0, 0.0], True, [0.2, -1.0, 1.0, -1.0]),  # to the goal, closed
    ],
)
def test_goes_above_the_cube_then_down_then_closes_then_to_the_goal(
    policy: SimpleNamespace, to_cube: list[float], grasped: bool, expected: list[float]
) -> None:
    observed = state(policy, to_cube=to_cube, to_goal=[0.02, -0.3, 0.3], grasped=grasped)
    action = policy.Policy().act({"state": observed})
    assert action.dtype == np.float32
    np.testing.assert_allclose(action, expected, atol=1e-6)


def test_the_parts_of_the_state_are_where_the_track_says(policy: SimpleNamespace) -> None:
    task = load_track("maniskill").tasks["pick-cube"]
    assert (task.definition.family, len(task.episodes), len(task.actions)) == (Family.MANISKILL, 100, 4)
    (observed,) = task.observables
    for part, place in (
        ("extra_is_grasped", f"{policy.IS_GRASPED}"),
        ("extra_tcp_to_obj_pos", f"{policy.TCP_TO_CUBE.start} to {policy.TCP_TO_CUBE.stop - 1}"),
        ("extra_obj_to_goal_pos", f"{policy.CUBE_TO_GOAL.start} to {policy.CUBE_TO_GOAL.stop - 1}"),
    ):
        assert f"{place} {part}" in observed.meaning
