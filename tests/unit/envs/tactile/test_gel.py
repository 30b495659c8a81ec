import hashlib
import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from vitac.envs.fem.model.mesh import GelMesh, MeshError, signed_volumes_m3
from vitac.envs.tactile.gel import (
    GelCells,
    GelDimensions,
    GelFilesError,
    arena_gel_mesh,
    eye_distance_m,
    gelsight_mini_mesh,
    highest_mm,
    read_gel,
    read_gmsh,
    structured_gel,
)

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


def gmsh_text(mesh: GelMesh) -> str:
    nodes, cells = mesh.rest_position_m, mesh.tetrahedra + 1
    lines = ["$MeshFormat", "4.1 0 8", "$EndMeshFormat", "$Nodes", f"1 {len(nodes)} 1 {len(nodes)}"]
    lines += [f"3 1 0 {len(nodes)}", *map(str, range(1, len(nodes) + 1))]
    lines += [" ".join(repr(float(x)) for x in node) for node in nodes]
    lines += ["$EndNodes", "$Elements", f"2 {len(cells) + 1} 1 {len(cells) + 1}", "2 1 2 1", "1 1 2 3"]
    lines += [f"3 1 4 {len(cells)}", *(f"{i} {a} {b} {c} {d}" for i, (a, b, c, d) in enumerate(cells.tolist(), 2))]
    return "\n".join([*lines, "$EndElements", ""])


def write_gel(directory: Path, mesh: GelMesh) -> Path:
    directory.mkdir()
    names = {"tet_mesh": "tet.msh", "active": "active.txt", "on_surface": "on_surface.txt", "faces": "faces.txt"}
    (directory / "meta_file").write_text(json.dumps(names))
    (directory / "tet.msh").write_text(gmsh_text(mesh))
    for name, mask in (("active", mesh.driven), ("on_surface", mesh.sensing)):
        (directory / f"{name}.txt").write_text("\n".join(str(int(value)) for value in mask))
    return directory


@pytest.fixture
def gel_dir(tmp_path: Path) -> Path:
    return write_gel(tmp_path / "gel", gelsight_mini_mesh())


def test_reads_what_was_written(gel_dir: Path) -> None:
    read, written = read_gel(gel_dir), gelsight_mini_mesh()
    assert read.name == "gel/tet.msh"
    for name in ("rest_position_m", "tetrahedra", "driven", "sensing"):
        assert np.array_equal(getattr(read, name), getattr(written, name))


def test_reads_the_challenges_gels(reference_dir: Path) -> None:
    mesh = read_gel(reference_dir / "assets" / "track1" / "gelsight_mini_e430")
    assert (len(mesh.rest_position_m), len(mesh.tetrahedra)) == (167, 430)
    assert (mesh.driven.sum(), mesh.sensing.sum()) == (83, 52)
    other = read_gel(reference_dir / "assets" / "track3" / "tac_sensor_meta" / "gelsight_mini")
    assert (len(other.rest_position_m), len(other.tetrahedra)) == (340, 875)
    assert (other.driven.sum(), other.sensing.sum()) == (138, 122)


@pytest.mark.parametrize("name", ["meta_file", "tet.msh", "active.txt", "on_surface.txt"])
def test_missing_file_is_named(gel_dir: Path, name: str) -> None:
    (gel_dir / name).unlink()
    with pytest.raises(GelFilesError, match=name.replace(".", r"\.") + ".*No such file"):
        read_gel(gel_dir)


def test_missing_folder_is_named(tmp_path: Path) -> None:
    with pytest.raises(GelFilesError, match=r"nowhere/meta_file"):
        read_gel(tmp_path / "nowhere")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("4.1 0 8", "2.2 0 8", "not Gmsh 4.1 ASCII.*'2.2 0'"),
        ("4.1 0 8", "4.1 1 8", "not Gmsh 4.1 ASCII"),
        ("$EndElements", "", "not closed"),
        ("3 1 4 320", "3 1 4 321", "shorter than its counts"),
        ("3 1 4 320", "3 1 11 320", "element type 11 is not supported"),
        ("1 162 1 162", "1 163 1 163", "162 nodes in the blocks, 163 announced"),
        ("3 1 0 162", "3 1 1 162", "parametric"),
        ("-0.012625", "nonsense", "holds no numbers"),
    ],
)
def test_malformed_mesh_is_refused(gel_dir: Path, old: str, new: str, message: str) -> None:
    path = gel_dir / "tet.msh"
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(GelFilesError, match=message):
        read_gel(gel_dir)


def test_tetrahedron_of_an_unknown_node_is_refused(gel_dir: Path) -> None:
    path = gel_dir / "tet.msh"
    path.write_text(re.sub(r"\d+\n\$EndElements", "999\n$EndElements", path.read_text()))
    with pytest.raises(GelFilesError, match="node 999, which"):
        read_gmsh(path)


def test_surface_mesh_without_tetrahedra_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "tet.msh"
    path.write_text(
        "$MeshFormat\n4.1 0 8\n$EndMeshFormat\n$Nodes\n1 3 1 3\n2 1 0 3\n1\n2\n3\n0 0 0\n1 0 0\n0 1 0\n$EndNodes\n"
        "$Elements\n1 1 1 1\n2 1 2 1\n1 1 2 3\n$EndElements\n"
    )
    with pytest.raises(GelFilesError, match="no tetrahedra"):
        read_gmsh(path)


@pytest.mark.parametrize("content", ["1 0 1", "", "2 " * 162])
def test_node_list_of_another_length_or_alphabet_is_refused(gel_dir: Path, content: str) -> None:
    (gel_dir / "active.txt").write_text(content)
    with pytest.raises(GelFilesError, match=r"active\.txt: expected a 0 or 1 for each of the 162 nodes"):
        read_gel(gel_dir)


@pytest.mark.parametrize("meta", ["", "[]", "{}", '{"tet_mesh": "../tet.msh", "active": "a", "on_surface": "b"}'])
def test_unusable_meta_file_is_refused(gel_dir: Path, meta: str) -> None:
    (gel_dir / "meta_file").write_text(meta)
    with pytest.raises(GelFilesError, match="meta_file"):
        read_gel(gel_dir)


def test_binary_file_is_refused(gel_dir: Path) -> None:
    (gel_dir / "tet.msh").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(GelFilesError, match="not ASCII"):
        read_gel(gel_dir)


def test_mesh_in_millimetres_is_refused(gel_dir: Path, tmp_path: Path) -> None:
    mesh = gelsight_mini_mesh()
    path = shutil.copytree(gel_dir, tmp_path / "large")
    text = gmsh_text(mesh)
    for value in sorted({repr(float(x)) for x in mesh.rest_position_m.ravel()}, key=len, reverse=True):
        text = text.replace(f"{value} ", f"{float(value) * 1e3!r} ").replace(
            f" {value}\n", f" {float(value) * 1e3!r}\n"
        )
    (path / "tet.msh").write_text(text)
    with pytest.raises(MeshError, match="must be in metres"):
        read_gel(path)
