import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from vitac.envs.scene.perspective import Plane, longest_action, signed


def test_heights_are_positive_on_the_normals_side() -> None:
    plane = Plane(normal=(0.0, -1.0, 0.0), offset_m=0.5)
    points_m = np.array([[[9.0, -0.5, 9.0], [0.0, -2.0, 0.0]], [[1.0, 0.0, 1.0], [0.0, 0.5, 0.0]]])
    assert plane.heights_m(points_m).tolist() == [[0.0, 1.5], [-0.5, -1.0]]


@pytest.mark.parametrize(
    ("value", "text"),
    [(1.0, "+1.00"), (-2.345, "−2.35"), (0.0, "+0.00"), (-0.0, "+0.00"), (-0.004, "+0.00"), (12.999, "+13.00")],
)
def test_numbers_have_a_sign_two_places_and_no_negative_zero(value: float, text: str) -> None:
    assert signed(value) == text


NUMBERS = st.lists(st.floats(-100.0, 100.0), min_size=3, max_size=3).map(np.array)


@given(NUMBERS)
def test_longest_action_goes_straight_and_not_beyond_the_end(distance: np.ndarray) -> None:
    scale = np.array([2.0, 2.0, 4.0])
    action = longest_action(distance, scale)
    assert action.dtype == np.float32
    assert np.abs(action).max() <= 1.0
    moved = action * scale
    assert np.allclose(np.cross(moved, distance), 0.0, atol=1e-3)
    if np.abs(distance / scale).max() > 1.0:
        assert np.abs(action).max() == pytest.approx(1.0)
    else:
        assert moved == pytest.approx(distance, abs=1e-5)
