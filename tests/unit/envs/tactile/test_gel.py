import hashlib
from pathlib import Path

import numpy as np
import pytest
from vitac.envs.fem.model.mesh import GelMesh, signed_volumes_m3
from vitac.envs.tactile.gel import (
    GelCells,
    GelDimensions,
    arena_gel_mesh,
    eye_distance_m,
    gelsight_mini_mesh,
    highest_mm,
    structured_gel,
)
from vitac.envs.tactile.gel_files import read_gel

CUBIC_MILLIMETRE_M3 = 1e-9


def volumes_mm3(mesh: GelMesh) -> np.ndarray:
    return np.asarray(signed_volumes_m3(mesh.rest_position_m[mesh.tetrahedra]) / CUBIC_MILLIMETRE_M3)


def edge_lengths_mm(mesh: GelMesh) -> np.ndarray:
    corners = mesh.rest_position_m[mesh.tetrahedra]
    pairs = [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)]
    return np.stack([np.linalg.norm(corners[:, i] - corners[:, j], axis=1) for i, j in pairs], axis=1) * 1e3


def quality(mesh: GelMesh) -> np.ndarray:
    return np.asarray(6 * np.sqrt(2) * volumes_mm3(mesh) / edge_lengths_mm(mesh).max(axis=1) ** 3)


def test_volume_is_that_of_box_and_bevel() -> None:
    frustum = (25.25 * 20.75 + 19.25 * 14.75 + (25.25 * 14.75 + 19.25 * 20.75) / 2) / 3
    assert volumes_mm3(gelsight_mini_mesh()).sum() == pytest.approx(25.25 * 20.75 * 3 + frustum, rel=1e-12)
    assert volumes_mm3(gelsight_mini_mesh()).sum() == pytest.approx(1969.75, abs=1e-9)


def test_node_sets_are_the_back_and_the_sensing_face() -> None:
    mesh = gelsight_mini_mesh()
    z_mm = mesh.rest_position_m[:, 2] * 1e3
    assert len(z_mm) == 162
    assert (mesh.driven == np.isclose(z_mm, -2.0)).all()
    assert (mesh.sensing == np.isclose(z_mm, 2.0)).all()
    assert (mesh.driven.sum(), mesh.sensing.sum()) == (81, 49)


def test_faces_have_the_stated_extents() -> None:
    mesh = gelsight_mini_mesh()
    back, top = mesh.rest_position_m[mesh.driven] * 1e3, mesh.rest_position_m[mesh.sensing] * 1e3
    assert back.max(axis=0) == pytest.approx([12.625, 10.375, -2.0])
    assert back.min(axis=0) == pytest.approx([-12.625, -10.375, -2.0])
    assert top.max(axis=0) == pytest.approx([9.625, 7.375, 2.0])
    assert top.min(axis=0) == pytest.approx([-9.625, -7.375, 2.0])


def test_every_tetrahedron_is_positive_and_well_shaped() -> None:
    mesh = gelsight_mini_mesh()
    assert volumes_mm3(mesh).min() > 3.0
    assert quality(mesh).min() > 0.25


def test_surface_is_closed_and_encloses_the_volume() -> None:
    mesh = gelsight_mini_mesh()
    corners = mesh.rest_position_m[mesh.surface_triangles]
    enclosed = (np.cross(corners[:, 0], corners[:, 1]) * corners[:, 2]).sum() / 6.0
    assert enclosed / CUBIC_MILLIMETRE_M3 == pytest.approx(1969.75)
    directed = np.concatenate([mesh.surface_triangles[:, [i, (i + 1) % 3]] for i in range(3)])
    assert {tuple(edge) for edge in directed.tolist()} == {tuple(edge) for edge in directed[:, ::-1].tolist()}


def test_boundary_follows_the_walls_and_bevel_planes() -> None:
    mesh = gelsight_mini_mesh()
    corners = mesh.rest_position_m[mesh.surface_triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    slope = np.sqrt(10.0)
    planes = [(1, 0, 0), (0, 1, 0), (0, 0, 1), (1 / slope, 0, 3 / slope), (0, 1 / slope, 3 / slope)]
    apart = np.abs(np.abs(normals)[:, None, :] - np.array(planes)[None]).max(axis=2).min(axis=1)
    assert apart.max() < 1e-12


@pytest.mark.parametrize("axis", [0, 1])
def test_mesh_is_mirror_symmetric(axis: int) -> None:
    mesh = gelsight_mini_mesh()
    mirrored = mesh.rest_position_m.copy()
    mirrored[:, axis] *= -1
    number = {
        tuple(position): i for i, position in enumerate((mesh.rest_position_m * 1e9).round().astype(int).tolist())
    }
    image = [number[tuple(position)] for position in (mirrored * 1e9).round().astype(int).tolist()]
    cells = {frozenset(cell) for cell in mesh.tetrahedra.tolist()}
    assert {frozenset(image[node] for node in cell) for cell in cells} == cells


def test_mesh_is_pinned() -> None:
    mesh = gelsight_mini_mesh()
    digest = hashlib.sha256(mesh.tetrahedra.astype("<i8").tobytes())
    digest.update((mesh.rest_position_m * 1e9).round().astype("<i8").tobytes())
    assert digest.hexdigest() == "1d3d682ec277a3951a058828ca66dfa39c404b05c97acc23ac160031501086d1"


def test_counts_are_near_those_of_the_challenges_mesh(reference_dir: Path) -> None:
    ours = gelsight_mini_mesh()
    theirs = read_gel(reference_dir / "assets" / "track1" / "gelsight_mini_e430")
    assert volumes_mm3(ours).sum() == pytest.approx(volumes_mm3(theirs).sum(), rel=1e-9)
    assert ours.driven.sum() == pytest.approx(theirs.driven.sum(), abs=3)
    assert ours.sensing.sum() == pytest.approx(theirs.sensing.sum(), abs=4)
    assert edge_lengths_mm(ours).mean() == pytest.approx(edge_lengths_mm(theirs).mean(), rel=0.1)
    assert quality(ours).min() > quality(theirs).min()


@pytest.mark.parametrize("cells", [GelCells(x=8, y=7, layers=2), GelCells(x=5, y=4, bevel=3, layers=4)])
def test_other_cells_fill_the_same_shape(cells: GelCells) -> None:
    """Up to the four corners of the bevel, where the cut follows the meeting of two planes only in part."""
    mesh = structured_gel(name="gel", cells=cells)
    lines = (cells.x + 2 * cells.bevel + 1, cells.y + 2 * cells.bevel + 1)
    assert len(mesh.driven) == lines[0] * lines[1] * (cells.layers + 1)
    assert int(mesh.sensing.sum()) == (cells.x + 1) * (cells.y + 1)
    assert volumes_mm3(mesh).sum() == pytest.approx(1969.75, rel=3e-3)


@pytest.mark.parametrize("thickness_mm", [2.5, 4.0, 8.0])
def test_gripper_and_camera_find_both_faces_at_any_thickness(thickness_mm: float) -> None:
    mesh = structured_gel(name="gel", size=GelDimensions(thickness_mm=thickness_mm))
    np.testing.assert_allclose(mesh.rest_position_m[mesh.sensing, 2] * 1e3, 2.0, rtol=1e-15)
    np.testing.assert_allclose(mesh.rest_position_m[mesh.driven, 2] * 1e3, 2.0 - thickness_mm)
    assert highest_mm(mesh) == 2.0
    assert eye_distance_m(mesh) == pytest.approx(0.018 + 1e-3 * thickness_mm - 0.002)


def test_camera_is_20_mm_behind_the_origin_of_the_challenges_gel() -> None:
    assert eye_distance_m(gelsight_mini_mesh()) == 0.02


def test_a_domed_face_falls_from_its_centre_to_its_rim() -> None:
    mesh = structured_gel(name="gel", size=GelDimensions(dome_mm=0.5))
    sensing_mm = mesh.rest_position_m[mesh.sensing] * 1e3
    centre = np.abs(sensing_mm[:, :2]).max(axis=1) < 1e-9
    rim = (np.abs(sensing_mm[:, 0]) > 9.6) | (np.abs(sensing_mm[:, 1]) > 7.3)
    assert sensing_mm[centre, 2] == pytest.approx(2.0)
    np.testing.assert_allclose(sensing_mm[rim, 2], 1.5)
    assert (sensing_mm[~centre & ~rim, 2] < 2.0).all()


def test_gel_of_arena_2_is_symmetric_and_finest_in_the_middle() -> None:
    mesh = arena_gel_mesh()
    assert (len(mesh.rest_position_m), len(mesh.hexahedra), mesh.driven.sum(), mesh.sensing.sum()) == (
        363,
        200,
        121,
        81,
    )
    for axis in (0, 1):
        mirrored = mesh.rest_position_m.copy()
        mirrored[:, axis] *= -1.0
        number = {tuple(place): node for node, place in enumerate(mesh.rest_position_m.round(9).tolist())}
        other = np.array([number[tuple(place)] for place in (mirrored.round(9) + 0.0).tolist()])
        edges = {tuple(edge) for edge in np.sort(mesh.surface_nodes[mesh.surface_edges]).tolist()}
        assert {tuple(edge) for edge in np.sort(other[mesh.surface_nodes[mesh.surface_edges]]).tolist()} == edges
    lines_mm = np.unique(mesh.rest_position_m[mesh.sensing, 0].round(9)) * 1e3
    lengths_mm = np.diff(lines_mm)
    assert lengths_mm[5:] / lengths_mm[4:-1] == pytest.approx(1.3)
    assert mesh.blocks.volume_m3.sum() == pytest.approx(1969.75e-9, rel=0.003)
