import numpy as np
import pytest
from polygon_area import signed_area
from vitac.envs.geometry.pegs import PLATE_OUTLINE_MM, PROFILES_MM, PegShape, hole_outline_mm
from vitac.envs.geometry.polygon import Polygon, as_polygon, orientation
from vitac.envs.geometry.solid import rectangle
from vitac.envs.geometry.triangulation import triangulate

COMB = as_polygon([(0, 0), (9, 0), (9, 1), (8, 1), (8, 2), (7, 2), (7, 1), (5, 1), (5, 2), (4, 2), (4, 1), (0, 1)])


def areas(outline: Polygon, holes: tuple[Polygon, ...], triangles: list[tuple[int, int, int]]) -> list[float]:
    points = np.concatenate([outline, *holes])
    return [0.5 * orientation(points[a], points[b], points[c]) for a, b, c in triangles]


@pytest.mark.parametrize("outline", [*PROFILES_MM.values(), COMB, rectangle(0, 1, 0, 2)])
def test_triangles_of_a_simple_polygon_cover_it_once(outline: Polygon) -> None:
    triangles = triangulate(outline)
    assert len(triangles) == len(outline) - 2
    assert min(areas(outline, (), triangles)) > 0
    assert sum(areas(outline, (), triangles)) == pytest.approx(signed_area(outline))


@pytest.mark.parametrize("shape", PegShape)
@pytest.mark.parametrize("turn", [1, -1])
def test_triangles_of_a_plate_leave_the_hole_open(shape: PegShape, turn: int) -> None:
    hole = hole_outline_mm(shape)
    triangles = triangulate(PLATE_OUTLINE_MM, (hole[::turn],))
    assert len(triangles) == 4 + len(hole)
    assert min(areas(PLATE_OUTLINE_MM, (hole[::turn],), triangles)) > 0
    assert sum(areas(PLATE_OUTLINE_MM, (hole[::turn],), triangles)) == pytest.approx(3500.0 - signed_area(hole))


def test_several_holes_in_a_row_are_left_open() -> None:
    outline = rectangle(0, 62, -20, 20)
    holes = tuple(rectangle(low, low + 8, -4, 4) for low in (15, 31, 47))
    triangles = triangulate(outline, holes)
    assert min(areas(outline, holes, triangles)) > 0
    assert sum(areas(outline, holes, triangles)) == pytest.approx(62 * 40 - 3 * 64)


def test_no_triangle_edge_passes_through_a_corner() -> None:
    for a, b, c in triangulate(COMB):
        for i, j in ((a, b), (b, c), (c, a)):
            for other in set(range(len(COMB))) - {i, j}:
                on_line = orientation(COMB[i], COMB[j], COMB[other]) == 0
                along = (COMB[other] - COMB[i]) @ (COMB[j] - COMB[i]) / ((COMB[j] - COMB[i]) ** 2).sum()
                assert not (on_line and 0 < along < 1)


def test_equal_input_gives_equal_triangles() -> None:
    hole = hole_outline_mm(PegShape.CONCAVE1)
    assert triangulate(PLATE_OUTLINE_MM, (hole,)) == triangulate(PLATE_OUTLINE_MM, (hole,))
