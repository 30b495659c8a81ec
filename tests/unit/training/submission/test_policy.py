"""What a trained submission computes."""

from pathlib import Path

import numpy as np
import pytest
from vitac.training.learning.network import Layout, logits, new_parameters
from vitac.training.submission import policy as module
from vitac.training.submission.policy import (
    CANDIDATES,
    EYE_MM,
    FELT_SIZE,
    HALF_WIDTH_MM,
    HISTORY_SIZE,
    MAX_STEPS,
    MOMENT_SIZE,
    History,
    Policy,
    belief_inputs,
    candidate_actions,
    felt_motion,
    history_features,
    start_angles_deg,
    values,
)


def networks(copies: int = 2) -> list[dict[str, np.ndarray]]:
    layout = Layout(inputs=HISTORY_SIZE, actions=3, hidden=8)
    return [new_parameters(layout, np.random.default_rng(seed)) for seed in range(copies)]


def stored(copies: list[dict[str, np.ndarray]]) -> dict[str, np.ndarray]:
    return {f"{number}_{name}": value for number, each in enumerate(copies) for name, value in each.items()}


# Where the camera of a sensor sees the peg's side, in the gripper's axes: x, y, z of a pixel's rays (facts 4.2).
def seen_by(side: float, peg_points_mm: np.ndarray) -> np.ndarray:
    x, y, z = peg_points_mm.T
    depth = EYE_MM - side * (y - side * HALF_WIDTH_MM)
    return np.column_stack([340.0 * z / depth + 160.0, -side * 325.0 * x / depth + 125.0])


def flow_of(shift_mm: np.ndarray, turn_deg: np.ndarray, noise_px: float = 0.0, count: int = 65) -> np.ndarray:
    """What the sensors show when the peg has moved a little as a rigid body."""
    random = np.random.default_rng(0)
    flows = []
    for side in (1.0, -1.0):
        places = np.column_stack(
            [random.uniform(-7, 7, 128), np.full(128, side * HALF_WIDTH_MM), random.uniform(-9, 9, 128)]
        )
        places[count:] = places[count - 1]
        moved = places + shift_mm + np.cross(np.radians(turn_deg), places)
        flow = np.stack([seen_by(side, places), seen_by(side, moved)])
        flow[:, :count] += noise_px * random.standard_normal((2, count, 2))
        flow[:, count:] = flow[:, count - 1 : count]
        flows.append(flow)
    return np.array(flows).astype(np.float32)


@pytest.mark.parametrize("number", range(6))
def test_small_motions_of_the_peg_are_felt(number: int) -> None:
    motion = np.zeros(6)
    motion[number] = 0.3
    found = felt_motion(flow_of(motion[:3], motion[3:]))
    assert found.shape == (FELT_SIZE,)
    assert found.dtype == np.float32
    assert found == pytest.approx(motion, abs=2e-3)


def test_noise_is_averaged_over_the_markers() -> None:
    motion = np.array([0.2, -0.1, 0.15, 0.5, -0.4, 0.3])
    found = felt_motion(flow_of(motion[:3], motion[3:], noise_px=0.5))
    assert np.abs(found[:3] - motion[:3]).max() < 0.05
    assert np.abs(found[3:] - motion[3:]).max() < 0.15


def test_repeated_marker_counts_once() -> None:
    few = flow_of(np.array([0.1, 0.0, 0.2]), np.zeros(3), noise_px=3.0, count=20)
    once = felt_motion(few)
    many = np.concatenate([few, few[:, :, -1:]], axis=2)
    np.testing.assert_array_equal(felt_motion(many), once)


def test_values_are_the_mean_of_the_networks() -> None:
    copies = networks()
    history = np.random.default_rng(1).standard_normal(HISTORY_SIZE).astype(np.float32)
    actions = candidate_actions(7)
    expected = np.mean([logits(each, history[None], actions)[0] for each in copies], axis=0)
    np.testing.assert_allclose(values(stored(copies), history, actions), expected, atol=1e-5)


def test_candidates_fill_the_cube() -> None:
    actions = candidate_actions(CANDIDATES)
    assert actions.shape == (CANDIDATES, 3)
    assert actions[0].tolist() == [0.0, 0.0, 0.0]
    assert np.abs(actions).max() <= 1.0
    corners = np.array([(x, y, z) for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
    nearest = np.abs(actions[:, None] - corners).max(axis=2).min(axis=0)
    assert nearest.max() < 0.2
    octants = np.unique((actions > 0) @ [1, 2, 4], return_counts=True)[1]
    assert octants.min() > 0.8 * CANDIDATES / 8


def test_history_has_all_that_was_felt_and_where_the_gripper_was() -> None:
    history = History()
    for number in range(3):
        history.observed(np.full(FELT_SIZE, number, dtype=np.float32), np.array([4.0, 0.0, 8.0, 0.0]) * number)
        if number < 2:
            history.acted(np.array([1.0, 0.0, 1.0], dtype=np.float32))
    found = history.features()
    assert found.shape == (HISTORY_SIZE,)
    moments = found[: 9 * MOMENT_SIZE].reshape(9, MOMENT_SIZE)
    np.testing.assert_array_equal(moments[0], moments[3])
    assert moments[1:5, FELT_SIZE].tolist() == [0.0, 1.0, 2.0, 0.0]
    assert moments[1:4, 0].tolist() == pytest.approx((0.5 * np.arcsinh(np.array([0, 1, 2]) / 0.05)).tolist())
    assert moments[1:5, -1].tolist() == [0, 1, 1, 0]
    assert moments[4:].any() == np.False_
    assert found[9 * MOMENT_SIZE :].tolist() == [0, 0, 1, 0, 0, 0, 0, 0]


def test_history_of_a_whole_episode_is_what_a_policy_had_at_each_moment() -> None:
    random = np.random.default_rng(0)
    felt = random.standard_normal((MAX_STEPS + 1, FELT_SIZE)).astype(np.float32)
    motions = random.standard_normal((MAX_STEPS + 1, 4)).astype(np.float32)
    actions = random.uniform(-1, 1, (MAX_STEPS, 3)).astype(np.float32)
    whole = history_features(felt, motions, actions)
    history = History()
    for number in range(MAX_STEPS):
        history.observed(felt[number], motions[number])
        np.testing.assert_array_equal(whole[number], history.features())
        history.acted(actions[number])
    assert not whole[MAX_STEPS].any()


def test_motion_tells_the_angle_of_the_gripper() -> None:
    start, action = np.radians(7.0), np.array([0.5, -0.25, 0.5], dtype=np.float32)
    sine, cosine = np.sin(start), np.cos(start)
    moved = 2.0 * np.array([cosine * 0.5 + sine * 0.25, sine * 0.5 - cosine * 0.25])
    motions = np.array([[0, 0, 0, 0], [*moved, 2.0, -0.125], [*moved, 2.0, -0.25]], dtype=np.float32)
    angles, known = start_angles_deg(motions, np.array([action, np.zeros(3)]))
    assert angles.tolist() == pytest.approx([0.0, 7.0, 7.0], abs=1e-4)
    assert known.tolist() == [0, 1, 1]
    later, known = start_angles_deg(
        np.array([[0, 0, 0, 0], [0, 0, 3.0, 0], [*moved, 5.0, 0]], dtype=np.float32), np.array([[0, 0, 0.75], action])
    )
    assert later.tolist() == pytest.approx([0.0, 0.0, 4.0], abs=1e-4)
    assert known.tolist() == [0, 0, 1]


def test_policy_takes_the_best_candidate(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    copies = networks()
    np.savez(tmp_path / "weights.npz", **stored(copies))  # type: ignore[arg-type]
    monkeypatch.setattr(module, "__file__", str(tmp_path / "policy.py"))
    policy = Policy()
    for _ in range(2):
        policy.reset("peg-insertion")
        seen = {"marker_flow": flow_of(np.ones(3), np.ones(3)), "relative_motion": np.zeros(4, dtype=np.float32)}
        action = policy.act(seen)
        history = History()
        history.observed(felt_motion(seen["marker_flow"]), seen["relative_motion"])
        scores = values(stored(copies), history.features(), policy.candidates)
        np.testing.assert_array_equal(action, policy.candidates[scores.argmax()])
        assert len(policy.history.felt) == 1
        np.testing.assert_array_equal(policy.history.actions, [action])


def test_a_belief_changes_no_action_and_weights_without_one_say_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "__file__", str(tmp_path / "policy.py"))
    kept = stored(networks())
    seen = {"marker_flow": flow_of(np.ones(3), np.ones(3)), "relative_motion": np.zeros(4, dtype=np.float32)}
    readout = np.random.default_rng(1).standard_normal((HISTORY_SIZE + 2 * 8 + 1, 3)).astype(np.float32)
    actions, beliefs = [], []
    for further in ({}, {"belief": readout}):
        np.savez(tmp_path / "weights.npz", **kept, **further)  # type: ignore[arg-type]
        policy = Policy()
        policy.reset("peg-insertion")
        actions.append(policy.act(seen))
        beliefs.append(policy.belief())
    np.testing.assert_array_equal(actions[0], actions[1])
    history = History()
    history.observed(felt_motion(seen["marker_flow"]), seen["relative_motion"])
    assert beliefs[0] is None
    assert beliefs[1] is not None
    np.testing.assert_allclose(beliefs[1], belief_inputs(kept, history.features()[None])[0] @ readout, rtol=1e-5)


def test_a_belief_is_made_of_the_history_and_of_what_the_first_layers_make_of_it() -> None:
    kept = stored(networks())
    histories = np.random.default_rng(1).standard_normal((2, HISTORY_SIZE)).astype(np.float32)
    found = belief_inputs(kept, histories)
    assert found.shape == (2, HISTORY_SIZE + 2 * 8 + 1)
    np.testing.assert_array_equal(found[:, :HISTORY_SIZE], histories)
    np.testing.assert_array_equal(found[:, -1], 1.0)
    second = np.maximum(histories @ kept["1_history"] + kept["1_bias0"], 0.0)
    np.testing.assert_array_equal(found[:, -9:-1], second)
    assert (second > 0.0).any()
