import drawn_gels
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from vitac.envs.sensor_design.placing import placed_on_base

offsets = st.floats(-1000.0, 1000.0)


@given(st.tuples(offsets, offsets, offsets))
def test_the_place_of_a_drawing_does_not_matter(by: tuple[float, float, float]) -> None:
    drawn = drawn_gels.wedge()
    placed = placed_on_base(drawn_gels.moved(drawn, by=by), length_mm=25.25, width_mm=20.75)
    expected = placed_on_base(drawn, length_mm=25.25, width_mm=20.75)
    np.testing.assert_allclose(placed.vertices_mm, expected.vertices_mm, atol=1e-9)
    np.testing.assert_array_equal(placed.triangles, drawn.triangles)


def test_base_is_centred_at_height_zero() -> None:
    placed = placed_on_base(drawn_gels.moved(drawn_gels.ridge(), by=(3.0, 2.0, 1.0)), length_mm=25.25, width_mm=20.75)
    low, high = placed.vertices_mm.min(axis=0), placed.vertices_mm.max(axis=0)
    assert low == pytest.approx([-12.625, -10.375, 0.0], abs=1e-12)
    assert high == pytest.approx([12.625, 10.375, 4.0], abs=1e-12)


def test_heights_are_not_stretched_with_the_base() -> None:
    drawn = drawn_gels.stretched(drawn_gels.dome(cells=6), (1.01, 0.99, 1.0))
    placed = placed_on_base(drawn, length_mm=25.25, width_mm=20.75)
    assert placed.extent_mm == pytest.approx([25.25, 20.75, drawn.extent_mm[2]])
    assert placed.volume_mm3 == pytest.approx(drawn.volume_mm3 / (1.01 * 0.99))


def test_placing_twice_changes_nothing_more() -> None:
    once = placed_on_base(drawn_gels.pyramids(), length_mm=25.25, width_mm=20.75)
    twice = placed_on_base(once, length_mm=25.25, width_mm=20.75)
    np.testing.assert_allclose(twice.vertices_mm, once.vertices_mm, atol=1e-12)
