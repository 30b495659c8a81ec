"""What looks the same in a mirror and after half a turn."""

import numpy as np
import pytest
from vitac.training.learning.critic import STATE_SIZE, stack_states
from vitac.training.learning.network import HISTORY, STATE, TURNABLE, Signs, both
from vitac.training.submission.policy import HISTORY_SIZE, History, felt_motion

ALL, NONE = np.array([True]), np.array([False])
ACTION = np.array([[0.1, 0.2, 0.3]], dtype=np.float32)


def state(truth: list[float]) -> np.ndarray:
    return stack_states(np.array([truth], dtype=np.float32), np.array([0]), np.array([2]))


# A peg at an offset that slipped by 0.3 and -0.2 mm and is tilted; the same in the mirror, and after half a turn.
TRUTH = [2.0, -1.0, 6.0, 2.3, -1.2, 19.5, 1.0, 2.0, 6.5]
MIRRORED_TRUTH = [-2.0, -1.0, -6.0, -2.3, -1.2, 19.5, 1.0, -2.0, -6.5]
TURNED_TRUTH = [-2.0, 1.0, 6.0, -2.3, 1.2, 19.5, -1.0, -2.0, 6.5]


def test_mirror_image_is_the_state_of_the_mirrored_world() -> None:
    found, action = STATE.changed(state(TRUTH), ACTION, ALL, NONE)
    np.testing.assert_allclose(found, state(MIRRORED_TRUTH), atol=1e-6)
    np.testing.assert_array_equal(action, ACTION * np.array([-1, 1, -1], dtype=np.float32))


def test_half_a_turn_is_the_state_of_the_turned_world() -> None:
    found, action = STATE.changed(state(TRUTH), ACTION, NONE, ALL)
    np.testing.assert_allclose(found, state(TURNED_TRUTH), atol=1e-6)
    np.testing.assert_array_equal(action, ACTION * np.array([-1, -1, 1], dtype=np.float32))


def in_the_mirror(marker_flow: np.ndarray) -> np.ndarray:
    """What the sensors see of the same events in a mirror with normal x: v turns round the picture's middle."""
    seen = marker_flow.copy()
    seen[..., 1] = 250.0 - seen[..., 1]
    return seen


def half_a_turn_later(marker_flow: np.ndarray) -> np.ndarray:
    """What the sensors see of the same events turned by half a turn: each has what the other had."""
    return marker_flow[::-1].copy()


@pytest.mark.parametrize(
    ("seen", "motion_signs", "action_signs", "flips", "turns"),
    [
        (in_the_mirror, [-1, 1, -1, 1], [-1, 1, -1], ALL, NONE),
        (half_a_turn_later, [-1, -1, 1, 1], [-1, -1, 1], NONE, ALL),
    ],
)
def test_changed_history_is_that_of_the_changed_episode(
    seen: object, motion_signs: list[int], action_signs: list[int], flips: np.ndarray, turns: np.ndarray
) -> None:
    random = np.random.default_rng(0)
    history, other = History(), History()
    for _ in range(3):
        flow = random.uniform(20, 220, (2, 2, 128, 2)).astype(np.float32)
        flow[:, 1] = flow[:, 0] + random.uniform(-9, 9, (2, 128, 2))
        motion, action = random.standard_normal(4), random.uniform(-1, 1, 3).astype(np.float32)
        history.observed(felt_motion(flow), motion)
        other.observed(felt_motion(seen(flow)), motion * motion_signs)  # type: ignore[operator]
        features, expected = history.features(), other.features()
        history.acted(action)
        other.acted(action * np.array(action_signs, dtype=np.float32))
    found, _ = HISTORY.changed(features[None], ACTION, flips, turns)
    turned_by_180 = np.isclose(np.abs(found[0] - expected), 360 / 8, atol=1e-3)
    np.testing.assert_allclose(np.where(turned_by_180, expected, found[0]), expected, atol=2e-3)


def test_only_chosen_rows_are_changed_and_twice_is_as_before() -> None:
    inputs = np.random.default_rng(0).standard_normal((6, HISTORY_SIZE)).astype(np.float32)
    actions = np.repeat(inputs[:, None, :3], 4, axis=1)
    chosen, none = np.array([True, False] * 3), np.zeros(6, dtype=np.bool_)
    for flips, turns in ((chosen, none), (none, chosen), (chosen, chosen)):
        once = HISTORY.changed(inputs, actions, flips, turns)
        assert [(row == other).all() for row, other in zip(once[0], inputs, strict=True)] == [False, True] * 3
        twice = HISTORY.changed(*once, flips, turns)
        np.testing.assert_array_equal(twice[0], inputs)
        np.testing.assert_array_equal(twice[1], actions)


def test_drawn_ones_are_turned_only_where_half_a_turn_changes_nothing() -> None:
    inputs, actions = np.ones((400, 1), dtype=np.float32), np.ones((400, 3), dtype=np.float32)
    signs = Signs(mirror=np.array([1], dtype=np.float32), turn=np.array([-1], dtype=np.float32))
    turnable = np.arange(400) < 200
    found, moved = signs.drawn(inputs, actions, turnable, np.random.default_rng(0))
    assert 60 < (found[:200] < 0).sum() < 140
    assert (found[200:] > 0).all()
    mirrored = moved[200:, 0] < 0
    assert 60 < mirrored.sum() < 140
    assert (moved[200:, 1] > 0).all()


def test_signs_stand_side_by_side_and_fit_what_they_change() -> None:
    assert both(STATE, HISTORY).mirror.shape == (STATE_SIZE + HISTORY_SIZE,)
    assert both(STATE, HISTORY).turn[:STATE_SIZE].tolist() == STATE.turn.tolist()
    assert set(np.abs(both(STATE, HISTORY).mirror)) == {1.0}
    assert TURNABLE == (0, 2)
