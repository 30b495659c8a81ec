import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from example_policies import flow, load

EXAMPLE = "peg_insertion_heuristic"


def observation(seed: int = 0) -> dict[str, Any]:
    random = np.random.default_rng(seed)
    load = np.array([[2.9, 0], [0, 0], [0, 0]])
    sensors = [flow(load + random.normal(0, 0.5, (3, 2)), 0.5, seed + side) for side in (0, 1)]
    return {"marker_flow": np.stack(sensors), "relative_motion": np.zeros(4, np.float32)}


def test_affine_motion_is_found_whatever_is_repeated(policy: ModuleType) -> None:
    motion = np.array([[2.5, -0.5], [0.25, 0.125], [-0.375, 0.75]])
    assert policy.affine_motion(*flow(motion)) == pytest.approx(motion.ravel(), abs=1e-4)


@pytest.mark.parametrize("seed", range(20))
def test_actions_are_finite_and_within_bounds(policy: ModuleType, seed: int) -> None:
    player = policy.Policy()
    player.reset("peg-insertion")
    action = player.act(observation(seed))
    assert (action.dtype, action.shape) == (np.float32, (3,))
    assert np.abs(action).max() <= 1


def test_after_two_readings_the_action_follows_the_motion_alone(policy: ModuleType) -> None:
    player = policy.Policy()
    player.reset("peg-insertion")
    player.act(observation(1))
    first = player.start.copy()
    player.act(observation(2))
    second = player.start.copy()
    assert not np.array_equal(first, second)
    there = observation(3)
    there["relative_motion"][:3] = -second
    assert player.act(there) == pytest.approx(np.zeros(3), abs=1e-3)
    assert np.array_equal(player.start, second)


def test_reset_forgets_the_episode_before(policy: ModuleType) -> None:
    used, fresh = policy.Policy(), policy.Policy()
    used.reset("peg-insertion")
    used.act(observation(1))
    for player in (used, fresh):
        player.reset("peg-insertion")
    assert used.act(observation(2)).tobytes() == fresh.act(observation(2)).tobytes()


def test_last_bits_of_an_observation_do_not_change_an_action(policy: ModuleType) -> None:
    first, second = observation(3), observation(3)
    second["marker_flow"] = np.nextafter(second["marker_flow"], np.float32(1000))
    actions = []
    for given in (first, second):
        player = policy.Policy()
        player.reset("peg-insertion")
        actions.append(player.act(given))
    assert np.abs(actions[0] - actions[1]).max() <= 0.0011


@pytest.mark.parametrize("angle", [0.0, 30.0, -90.0])
def test_action_turns_with_the_gripper(policy: ModuleType, angle: float) -> None:
    x, y, theta = policy.towards_hole(np.array([0.25, 0.0, 0.0]), np.array([0.25, -0.25, angle])) * [2, 2, 4]
    turn = np.radians(angle)
    world = [x * np.cos(turn) - y * np.sin(turn), x * np.sin(turn) + y * np.cos(turn)]
    assert world == pytest.approx([-0.5, 0.25], abs=4e-3)
    assert theta == 0


def test_peg_that_did_not_slip_in_is_rocked(policy: ModuleType) -> None:
    player = policy.Policy()
    player.reset("peg-insertion")
    assert [player.act(observation(4))[2] for _ in range(7)] == [0, 0, 0, 1, -1, 1, -1]


def test_fit_recovers_what_can_be_told_and_leaves_the_rest_alone(
    example: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(str(example / "Track_1"))
    train = load(example / "train.py")
    sys.modules.pop("policy", None)
    random = np.random.default_rng(0)
    felt = random.normal(0, 1, (1500, 24))
    offsets = np.stack([2 * felt[:, 0], -felt[:, 3] + random.normal(0, 0.5, 1500), random.normal(0, 5, 1500)], axis=1)
    weights, explained = train.fit(felt, offsets, 1.5)
    assert explained[0] > 0.98
    assert explained[1] == pytest.approx(0.8, abs=0.05)
    assert np.array(weights["weights"])[0, 0] == pytest.approx(2 * 1.5, rel=0.1)
    assert not np.array(weights["weights"])[:, 2].any()
