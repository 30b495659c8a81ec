import numpy as np
import pytest
from vitac.envs.drawing.projection.camera import ParallelCamera
from vitac.envs.drawing.projection.edges import sharp_edges, unique_edges, unit_normals, visible_lines
from vitac.envs.drawing.projection.visibility import Visible
from vitac.envs.geometry.pegs import PegShape, hole_surface, peg_surface
from vitac.envs.tactile.gel import gelsight_mini_mesh

FRONT = ParallelCamera(
    azimuth_deg=-90.0, elevation_deg=0.0, centre_m=(0.0, 0.0, 0.0), height_m=0.03, width_px=40, height_px=30
)


@pytest.mark.parametrize(("shape", "corners"), [(PegShape.CUBOID, 4), (PegShape.CONCAVE1, 8)])
def test_a_prism_has_the_edges_of_its_profile_and_no_diagonals(shape: PegShape, corners: int) -> None:
    peg, plate = peg_surface(shape), hole_surface(shape)
    assert len(sharp_edges(peg.vertices_m, peg.triangles)) == 3 * corners
    assert len(sharp_edges(plate.vertices_m, plate.triangles)) == 12 + 3 * corners


def test_a_gel_has_the_edges_of_a_bevelled_box() -> None:
    gel = gelsight_mini_mesh()
    ends_mm = 1e3 * gel.rest_position_m[sharp_edges(gel.rest_position_m, gel.surface_triangles)]
    assert np.abs(ends_mm[..., 2]).min() >= 1.0
    total_mm = np.linalg.norm(ends_mm[:, 1] - ends_mm[:, 0], axis=1).sum()
    slanted = 4 * np.sqrt(3**2 + 3**2 + 1)
    assert total_mm == pytest.approx(2 * 2 * (25.25 + 20.75) + 2 * (19.25 + 14.75) + 4 * 3 + slanted)


def test_every_edge_of_a_closed_surface_comes_once() -> None:
    triangles = gelsight_mini_mesh().surface_triangles
    edges = unique_edges(triangles)
    assert len(edges) == len({tuple(sorted(edge)) for edge in edges.tolist()}) == 3 * len(triangles) // 2


def test_normals_point_outwards() -> None:
    peg = peg_surface(PegShape.CUBOID)
    outwards = peg.vertices_m[peg.triangles].mean(axis=1) - peg.vertices_m.mean(axis=0)
    normals = unit_normals(peg.vertices_m, peg.triangles)
    assert np.linalg.norm(normals, axis=1) == pytest.approx(1.0)
    assert ((normals * outwards).sum(axis=1) > 0).all()


def test_a_line_is_seen_on_both_sides_of_what_hides_its_middle() -> None:
    visible = Visible.nothing(FRONT)
    visible.add(
        np.array([[[15, 0, 0], [25, 0, 0], [25, 30, 0]], [[15, 0, 0], [25, 30, 0], [15, 30, 0]]], float), first=0
    )
    behind = np.array([[[-0.018, 0.01, 0.0], [0.018, 0.01, 0.0]]])
    before = behind - np.array([0.0, 0.02, 0.0])
    left, right = visible_lines(behind, FRONT, visible)
    assert left[0] == pytest.approx([2, 15])
    assert 13 <= left[-1, 0] < 15
    assert 25 <= right[0, 0] <= 27
    assert right[-1] == pytest.approx([38, 15])
    (whole,) = visible_lines(before, FRONT, visible)
    assert whole[[0, -1]] == pytest.approx(np.array([[2, 15], [38, 15]]))


def test_a_line_ends_where_it_is_cut_away() -> None:
    ends = np.array([[[-0.01, 0.0, 0.0], [0.01, 0.0, 0.0]]])
    (line,) = visible_lines(ends, FRONT, Visible.nothing(FRONT), kept_m=np.array([[0.01, -0.01]]))
    assert line[0] == pytest.approx([10, 15])
    assert 18 <= line[-1, 0] <= 20.1
