"""The policy of a search: what it feels, and how it acts."""

from pathlib import Path

import numpy as np
import pytest
from toy_lock import MARKERS, turned_flow
from vitac.training.search import policy
from vitac.training.search.policy import ACTIONS, FEATURES, Opening, Policy, rigid_motion

WEIGHTS = np.zeros((ACTIONS, FEATURES))


@pytest.mark.parametrize(
    ("flow", "expected"),
    [
        (turned_flow(0.0), [1, 0, 0, 0, 0]),
        (turned_flow(0.02), [1, 0, 0, 2, np.tanh(2)]),
        (turned_flow(-0.01), [1, 0, 0, -1, np.tanh(-1)]),
        (turned_flow(0.0, inwards_px=5), [1, 0.5, 0, 0, 0]),
        (turned_flow(0.0, up_px=-20), [1, 0, -2, 0, 0]),
        (turned_flow(0.01, inwards_px=-10, up_px=10), [1, -1, 1, 1, np.tanh(1)]),
        (turned_flow(0.0, outwards_px=8), [1, 0, 0, 0, 0]),
    ],
)
def test_feels_how_the_handle_moves_between_the_gels(flow: np.ndarray, expected: list[float]) -> None:
    np.testing.assert_allclose(Opening(WEIGHTS).features(flow), [*expected, 0, 0, 1], atol=2e-4)


def test_remembers_how_far_it_pulled_and_for_how_long() -> None:
    weights = WEIGHTS.copy()
    weights[0, 0] = -0.75
    opening = Opening(weights)
    for _ in range(2):
        opening.act(turned_flow(0.0))
    assert (opening.env_steps, opening.pulled_mm) == (2, 3.0)
    np.testing.assert_allclose(opening.features(turned_flow(0.0)), [1, 0, 0, 0, 0, 0.75, 0.5, 0], atol=2e-4)


def test_remembers_what_was_played_not_what_was_wanted() -> None:
    weights = WEIGHTS.copy()
    weights[0, 0] = -7.0
    opening = Opening(weights)
    opening.act(turned_flow(0.0))
    assert opening.pulled_mm == 2.0


def test_markers_that_fill_the_array_do_not_count() -> None:
    reference, current = turned_flow(0.01, inwards_px=3)[0]
    filled = rigid_motion(reference, current)
    np.testing.assert_allclose(filled, rigid_motion(reference[:MARKERS], current[:MARKERS]), rtol=1e-6)


def test_a_single_marker_has_no_rotation() -> None:
    reference = np.full((8, 2), 100.0)
    assert rigid_motion(reference, reference + np.array([1.0, -2.0])) == (1.0, -2.0, 0.0)


def test_action_is_the_weighted_sum_within_bounds() -> None:
    weights = WEIGHTS.copy()
    weights[0, 3], weights[1, 0] = -0.25, -5.0
    found = Opening(weights).act(turned_flow(0.02))
    np.testing.assert_allclose(found, [-0.5, -1.0], atol=1e-4)
    assert found.dtype == np.float32
    assert found.shape == (ACTIONS,)


def test_policy_reads_the_weights_beside_it_and_begins_every_episode_anew(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    weights = np.arange(16.0).reshape(ACTIONS, FEATURES) / 20
    np.savez(tmp_path / "weights.npz", weights=weights)
    monkeypatch.setattr(policy, "__file__", str(tmp_path / "policy.py"))
    flow = turned_flow(0.005, up_px=2)
    made, opening = Policy(), Opening(weights)
    expected = [opening.act(flow), opening.act(flow)]
    assert not np.array_equal(expected[0], expected[1])
    for _ in range(2):
        made.reset("lock-opening")
        np.testing.assert_array_equal([made.act({"marker_flow": flow}) for _ in range(2)], expected)


def test_weights_that_are_pickled_are_not_opened(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    np.savez(tmp_path / "weights.npz", weights=np.array([{}], dtype=object))
    monkeypatch.setattr(policy, "__file__", str(tmp_path / "policy.py"))
    with pytest.raises(ValueError, match="allow_pickle=False"):
        Policy()
