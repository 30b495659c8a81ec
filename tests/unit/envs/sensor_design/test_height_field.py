import drawn_gels
import numpy as np
import pytest
from numpy.typing import NDArray
from vitac.envs.sensor_design.height_field import HeightField, NotAHeightField, heights_of_faces_mm
from vitac.envs.sensor_design.surface import DrawnSurface

FloatArray = NDArray[np.float64]
CREASE_COSINE = 0.98


def length_mm(surface: DrawnSurface, *, is_wall: bool) -> float:
    lines = [line for line in HeightField(surface).lines(crease_cosine=CREASE_COSINE) if line.is_wall is is_wall]
    return float(sum(np.hypot(*np.subtract(line.second, line.first)) for line in lines))


def heights_at(surface: DrawnSurface, points: FloatArray) -> FloatArray:
    return heights_of_faces_mm(points, points, HeightField(surface).upper_corners_mm)


def test_a_box_has_walls_on_its_edge_and_no_crease() -> None:
    box = drawn_gels.flat()
    assert length_mm(box, is_wall=True) == pytest.approx(2 * (25.25 + 20.75))
    assert length_mm(box, is_wall=False) == 0.0
    assert HeightField(box).upper_slopes == pytest.approx([1.0, 1.0])


def test_a_bevel_has_creases_at_its_upper_edge_and_its_corners() -> None:
    top = 2 * (23.25 + 18.75)
    assert length_mm(drawn_gels.bevelled(), is_wall=False) == pytest.approx(top + 4 * np.sqrt(2.0))


def test_a_ridge_has_a_wall_at_its_foot_and_one_at_its_top() -> None:
    edge, ridge = 2 * (25.25 + 20.75), 2 * (2.0 + 14.0)
    assert length_mm(drawn_gels.ridge(), is_wall=True) == pytest.approx(edge + 2 * ridge)
    assert length_mm(drawn_gels.ridge(), is_wall=False) == 0.0


def test_creases_below_the_angle_are_left_away() -> None:
    field = HeightField(drawn_gels.pyramids())
    kept = [len(list(field.lines(crease_cosine=cosine))) for cosine in (-1.0, 0.7, 0.98)]
    assert kept[0] < kept[1] <= kept[2]


def test_slopes_are_cosines_to_the_base() -> None:
    slopes = HeightField(drawn_gels.pyramids()).upper_slopes
    # A pyramid 5 mm wide and 2 mm high.
    assert np.unique(slopes.round(12)) == pytest.approx([2.5 / np.hypot(2.5, 2.0), 1.0])


def test_heights_are_those_of_the_drawing() -> None:
    points = np.array([[5.0, 4.0], [5.0, 5.0], [6.5, 4.0], [2.6, 4.0], [0.0, 0.0], [-12.0, 10.0]])
    assert heights_at(drawn_gels.pyramids(), points) == pytest.approx([4.5, 3.7, 3.3, 2.58, 2.5, 2.5])


def test_heights_of_a_ramp_rise_linearly() -> None:
    x = np.linspace(-4.9, 4.9, 15)
    points = np.column_stack([x, np.zeros(15)])
    assert heights_at(drawn_gels.wedge(), points) == pytest.approx(3.5 + 0.1 * x)


def test_the_plane_of_a_face_is_continued_beyond_it() -> None:
    """Heights at corners are looked up inside, on the right side of a wall, and continued to the corner."""
    faces = HeightField(drawn_gels.wedge()).upper_corners_mm
    inside, corner = np.array([[4.9, 0.0]]), np.array([[8.0, 0.0]])
    assert heights_of_faces_mm(inside, corner, faces) == pytest.approx([4.3])


def test_a_point_beside_all_faces_takes_the_nearest() -> None:
    assert heights_at(drawn_gels.wedge(), np.array([[20.0, 0.0]])) == pytest.approx([3.0])


def test_heights_do_not_depend_on_the_order_of_points() -> None:
    points = np.random.default_rng(0).uniform(-9.0, 9.0, (50, 2))
    order = np.random.default_rng(1).permutation(50)
    dome = drawn_gels.dome(cells=9)
    np.testing.assert_array_equal(heights_at(dome, points)[order], heights_at(dome, points[order]))


def test_a_face_that_looks_down_is_named_by_its_place() -> None:
    leaning = drawn_gels.leaning(1.0)
    with pytest.raises(NotAHeightField, match=r"\d triangles face the base from above, one at \(.*\) mm, .* mm above"):
        HeightField(leaning)


def test_a_wall_that_hardly_leans_is_a_wall() -> None:
    HeightField(drawn_gels.leaning(8e-3))
    with pytest.raises(NotAHeightField):
        HeightField(drawn_gels.leaning(12e-3))
