"""What a trained submission computes."""

from pathlib import Path

import numpy as np
import pytest
from vitac.training.network import Layout, logits, new_parameters
from vitac.training.submission import policy as module
from vitac.training.submission.policy import (
    CANDIDATES,
    FIELD_SIZE,
    HISTORY_SIZE,
    History,
    Policy,
    candidate_actions,
    motion_field,
    values,
)


def flow(motion: tuple[float, float], count: int = 60) -> np.ndarray:
    random = np.random.default_rng(0)
    reference = random.uniform([10, 20], [310, 230], (2, 128, 2))
    reference[:, count:] = reference[:, count - 1 : count]
    return np.stack([reference, reference + motion], axis=1).astype(np.float32)


def networks(copies: int = 2) -> list[dict[str, np.ndarray]]:
    layout = Layout(inputs=HISTORY_SIZE, actions=3, hidden=8)
    return [new_parameters(layout, np.random.default_rng(seed)) for seed in range(copies)]


def stored(copies: list[dict[str, np.ndarray]]) -> dict[str, np.ndarray]:
    return {f"{number}_{name}": value for number, each in enumerate(copies) for name, value in each.items()}


def test_field_of_an_even_motion_is_even() -> None:
    field = motion_field(flow((3.0, -2.0)))
    assert field.shape == (FIELD_SIZE,)
    assert field.dtype == np.float32
    assert field.reshape(-1, 2) == pytest.approx(np.tile([0.3, -0.2], (FIELD_SIZE // 2, 1)), abs=1e-5)


def test_repeated_marker_counts_once() -> None:
    few = flow((0.0, 0.0), count=30)
    few[:, 1, 29:, 0] += 50.0
    once = motion_field(few)
    assert np.abs(once).max() < 5.0
    more = few.copy()
    more[:, :, 30:] = few[:, :, 29:30]
    np.testing.assert_array_equal(motion_field(more), once)


def test_field_shows_where_the_motion_is() -> None:
    seen = flow((0.0, 0.0))
    lower = seen[0, 0, :, 1] > 125
    seen[0, 1, lower, 0] += 4.0
    left, right = motion_field(seen).reshape(2, 3, 4, 2)
    assert left[2, :, 0].min() > 0.3 > 0.1 > left[0, :, 0].max()
    assert np.abs(right).max() == 0.0


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


def test_history_has_now_before_and_first() -> None:
    history = History()
    fields = [np.full(FIELD_SIZE, value, dtype=np.float32) for value in (1.0, 2.0, 3.0)]
    for number, field in enumerate(fields):
        history.add(field, np.array([4.0, 0.0, 0.0, 0.0]) * number)
    found = history.features()
    assert found.shape == (HISTORY_SIZE,)
    assert found[[0, FIELD_SIZE, 2 * FIELD_SIZE]].tolist() == [3.0, 2.0, 1.0]
    assert found[[3 * FIELD_SIZE, 3 * FIELD_SIZE + 4]].tolist() == [2.0, 1.0]
    assert found[3 * FIELD_SIZE + 8 :].tolist() == [0, 0, 1, 0, 0, 0, 0, 0]


def test_policy_takes_the_best_candidate(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    copies = networks()
    np.savez(tmp_path / "weights.npz", **stored(copies))  # type: ignore[arg-type]
    monkeypatch.setattr(module, "__file__", str(tmp_path / "policy.py"))
    policy = Policy()
    for _ in range(2):
        policy.reset("peg-insertion")
        seen = {"marker_flow": flow((1.0, 2.0)), "relative_motion": np.zeros(4, dtype=np.float32)}
        action = policy.act(seen)
        scores = values(stored(copies), policy.history.features(), policy.candidates)
        np.testing.assert_array_equal(action, policy.candidates[scores.argmax()])
        assert len(policy.history.fields) == 1
