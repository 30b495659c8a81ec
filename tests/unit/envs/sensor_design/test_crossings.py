from functools import partial

import drawn_gels
import numpy as np
import pytest
from vitac.envs.sensor_design.crossings import NONE, TOO_MANY, farthest, first_crossing
from vitac.envs.sensor_design.surface import DrawnSurface

SOUND = {"flat": drawn_gels.flat, "ridge": drawn_gels.ridge, "pyramids": drawn_gels.pyramids, "dome": drawn_gels.dome}


def crossing(surface: DrawnSurface, max_pairs: int = 10**6) -> tuple[int, int]:
    return first_crossing(surface.vertices_mm, surface.triangles, max_pairs)


@pytest.mark.parametrize("name", SOUND)
def test_sound_surface_has_none(name: str) -> None:
    assert crossing(SOUND[name]()) == (NONE, NONE)


def test_bodies_that_run_into_each_other_are_found() -> None:
    small = drawn_gels.moved(drawn_gels.flat(2.0), scale=0.5, by=(1.3, 0.7, 3.5))
    surface = drawn_gels.together(drawn_gels.flat(), small)
    first, second = crossing(surface)
    assert 0 <= first < second < len(surface.triangles)
    assert surface.shells[first] != surface.shells[second]


def test_vertex_pulled_through_the_opposite_face_is_found() -> None:
    surface = drawn_gels.pyramids()
    surface.vertices_mm[surface.vertices_mm[:, 2].argmax(), 2] = -1.0
    assert crossing(surface) != (NONE, NONE)


def test_top_that_dips_through_a_base_on_the_same_grid_is_found() -> None:
    """Its edges lie exactly above those of the base, so that none goes through the inside of a triangle."""
    dip = drawn_gels.smooth(lambda x, y: -2.0 if abs(x) + abs(y) < 5.0 else 4.0, 6)
    assert crossing(dip) != (NONE, NONE)


@pytest.mark.parametrize(("height", "crosses"), [(0.0, True), (1e-9, False)])
def test_edge_that_ends_on_a_triangle_meets_it_and_one_that_ends_above_does_not(height: float, crosses: bool) -> None:
    vertices = np.array([[0.0, 0, 0], [2, 0, 0], [0, 2, 0], [0.5, 0.0, height], [0.5, 0.5, 3], [0.6, -0.5, 3]])
    assert (first_crossing(vertices, np.array([[0, 1, 2], [3, 4, 5]]), 10) == (0, 1)) is crosses


def test_triangles_of_one_leaning_plane_do_not_cross() -> None:
    for slope in (0.1, 0.3, 1.7):
        leaning = drawn_gels.smooth(partial(plane, slope), 9)
        assert crossing(leaning) == (NONE, NONE)


def plane(slope: float, x: float, y: float) -> float:
    return 30.0 + slope * x + y / 3.0


def test_triangle_folded_onto_its_neighbour_is_found() -> None:
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0.1, 0.5, 0]])
    assert first_crossing(vertices, np.array([[0, 1, 2], [1, 0, 3]]), 10) == (0, 1)


def test_too_many_near_pairs_are_not_looked_at() -> None:
    assert crossing(drawn_gels.dome(), max_pairs=10) == (TOO_MANY, TOO_MANY)


def test_farthest_point_and_its_distance() -> None:
    surface = drawn_gels.flat()
    points = np.array([[0.0, 0.0, 4.5], [0.0, 0.0, 2.0], [15.0, 0.0, 1.0]])
    point, distance = farthest(points, surface.vertices_mm, surface.triangles)
    assert point == 2
    assert distance == pytest.approx(15.0 - 12.625)


def test_points_of_a_surface_are_on_it() -> None:
    surface = drawn_gels.wedge()
    assert farthest(surface.vertices_mm, surface.vertices_mm, surface.triangles)[1] < 1e-12
