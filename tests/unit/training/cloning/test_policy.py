"""What a cloned policy remembers, feels and sees."""

import numpy as np
import pytest
from toy_lock import turned_flow
from vitac.training.cloning.policy import (
    NOISE_PX,
    SEEN_SCALE_PX,
    WINDOW,
    compute_moments,
    fit_motion,
    make_windows,
    read_observation,
)


def test_windows_have_the_newest_row_first_and_say_what_is_there() -> None:
    rows = np.arange(1, 2 * (WINDOW + 2) + 1, dtype=np.float32).reshape(-1, 2)
    windows = make_windows(rows)
    assert windows.shape == (WINDOW + 2, 3 * WINDOW)
    assert windows[1, :4].tolist() == [3, 4, 1, 2]
    assert not windows[1, 4 : 2 * WINDOW].any()
    assert windows[:, 2 * WINDOW :].sum(axis=1).tolist() == [*range(1, WINDOW + 1), WINDOW, WINDOW]
    assert windows[-1, 2 * WINDOW - 2 : 2 * WINDOW].tolist() == rows[2].tolist()


def test_motion_of_a_gel_is_fitted_and_repeated_markers_do_not_count() -> None:
    flow = turned_flow(0.01, inwards_px=3.0)
    for side, (reference, current) in zip((-1.0, 1.0), flow, strict=True):
        constant, slopes = np.split(fit_motion(reference, current), [2])
        np.testing.assert_allclose(slopes, [0.0, side, -side, 0.0], atol=1e-4)
        np.testing.assert_allclose(constant, [3.0 - side * 0.05, 0.0], atol=1e-3)


def test_moments_follow_what_is_seen() -> None:
    mask = np.zeros((40, 80), dtype=np.bool_)
    mask[10:20, 20:60] = True
    moved = np.roll(mask, (4, 8), axis=(0, 1))
    found, shifted = compute_moments(mask), compute_moments(moved)
    np.testing.assert_allclose(shifted - found, [0, 8 / SEEN_SCALE_PX, 4 / SEEN_SCALE_PX, *[0] * 7], atol=1e-12)
    assert found[0] == 400 / SEEN_SCALE_PX**2
    assert found[3] > 10 * found[5] > 0
    assert not compute_moments(np.zeros_like(mask)).any()


def test_numbers_of_an_observation_do_not_depend_on_its_order() -> None:
    observation = {
        "relative_motion": np.ones(3),
        "marker_flow": turned_flow(0.0, inwards_px=NOISE_PX),
        "a": np.zeros(1),
    }
    found = read_observation(observation)
    assert found[:4].tolist() == [0, 1, 1, 1]
    assert len(found) == 4 + 12
    assert found[4] == pytest.approx(np.arcsinh(1.0), abs=1e-3)
    np.testing.assert_array_equal(read_observation(dict(reversed(observation.items()))), found)
