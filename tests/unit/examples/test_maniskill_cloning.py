"""The cloned policy of ManiSkill's PickCube-v1: its weights as shipped, and its answers where torch is installed."""

from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from example_policies import imported
from vitac.evaluator.submission.manifest import load_manifest
from vitac.evaluator.tracks import load_track

TASK = load_track("maniskill").tasks["pick-cube"]


@pytest.fixture(scope="module")
def folder(repository: Path) -> Path:
    return repository / "examples" / "maniskill_cloning" / "ManiSkill"


def test_its_weights_are_small_finite_and_fit_the_task(folder: Path) -> None:
    assert (folder / "weights.npz").stat().st_size < 100_000
    with np.load(folder / "weights.npz", allow_pickle=False) as stored:
        weights = dict(stored)
    ((size,), n_actions) = TASK.observables[0].shape, len(TASK.actions)
    assert all(np.isfinite(value).all() and value.dtype == np.float32 for value in weights.values())
    assert (weights["mean"].shape, weights["scale"].shape, weights["0.weight"].shape[1]) == ((size,), (size,), size)
    assert weights["4.bias"].shape == (n_actions,)
    assert (weights["scale"] > 0).all()


def test_as_plain_arithmetic_the_network_moves_to_the_cube_and_closes_on_it(folder: Path) -> None:
    """Its sums without torch: above the cube the hand goes down and is open, at the cube it closes."""
    with np.load(folder / "weights.npz", allow_pickle=False) as stored:
        weights = dict(stored)

    def answer(to_cube: list[float], grasped: float = 0.0) -> np.ndarray:
        state = weights["mean"].copy()
        state[18], state[36:39] = grasped, to_cube
        hidden = (state - weights["mean"]) / weights["scale"]
        for layer in ("0", "2"):
            hidden = np.maximum(weights[f"{layer}.weight"] @ hidden + weights[f"{layer}.bias"], 0.0)
        found: np.ndarray = weights["4.weight"] @ hidden + weights["4.bias"]
        return found

    assert answer([0.0, 0.0, -0.1])[3] > answer([0.0, 0.0, 0.0], grasped=1.0)[3]


def test_it_names_its_task(folder: Path) -> None:
    assert list(load_manifest(folder).tasks) == [TASK.name]


@pytest.mark.skipif(find_spec("torch") is None, reason="torch is not installed")
def test_its_action_is_in_the_box_and_the_gripper_opens_or_closes(folder: Path) -> None:
    with imported(folder) as modules:
        policy = modules.policy.Policy()
        policy.reset(TASK.name)
        for seed in range(20):
            state = np.random.default_rng(seed).normal(size=42).astype(np.float32)
            action = policy.act({"state": state})
            assert (action.shape, action.dtype) == ((4,), np.float32)
            assert (np.abs(action) <= 1.0).all()
            assert abs(action[3]) == 1.0
