import numpy as np
import pytest
from numpy.typing import NDArray
from vitac.evaluator.estimator import COUNT, compute_features


def flow(motion: NDArray[np.float64] | tuple[float, float], markers: int = 40, total: int = 128) -> NDArray[np.float32]:
    """Two sensors with markers over the picture, each moved so, the last repeated to fill the array."""
    random = np.random.default_rng(1)
    reference = random.uniform((20.0, 20.0), (300.0, 220.0), (2, markers, 2))
    both = np.stack([reference, reference + motion], axis=1)
    return np.concatenate([both, np.repeat(both[:, :, -1:], total - markers, axis=2)], axis=2).astype(np.float32)


def test_common_motion_is_the_constant_of_its_direction() -> None:
    found = np.array(compute_features(flow((3.0, -2.0)))).reshape(2, 2, 6)
    np.testing.assert_allclose(found[:, 0, 0], 3.0, rtol=0.02)
    np.testing.assert_allclose(found[:, 1, 0], -2.0, rtol=0.02)
    assert np.abs(found[:, :, 1:]).max() < 0.1


def test_turn_of_the_markers_is_in_the_linear_terms() -> None:
    rest = flow((0.0, 0.0)).astype(np.float64)
    x, y = (rest[:, 0, :, 0] - 160) / 160, (rest[:, 0, :, 1] - 120) / 120
    rest[:, 1, :, 0] += -2.0 * y
    rest[:, 1, :, 1] += 2.0 * x
    found = np.array(compute_features(rest.astype(np.float32))).reshape(2, 2, 6)
    np.testing.assert_allclose(found[:, 0, 2], -2.0, rtol=0.05)
    np.testing.assert_allclose(found[:, 1, 1], 2.0, rtol=0.05)


def test_repeats_of_the_last_marker_count_once() -> None:
    random = np.random.default_rng(0).normal(0.0, 0.5, (2, 40, 2))
    assert compute_features(flow(random, total=128)) == compute_features(flow(random, total=41))


@pytest.mark.parametrize("markers", [1, 2, 5])
def test_few_markers_give_finite_features(markers: int) -> None:
    assert np.isfinite(compute_features(flow((1.0, 1.0), markers))).all()


def test_markers_at_rest_give_zeros_whatever_is_seen() -> None:
    assert compute_features(flow((5.0, 5.0)), at_rest=True) == [0.0] * COUNT
    assert compute_features(flow((0.0, 0.0))) == [0.0] * COUNT
