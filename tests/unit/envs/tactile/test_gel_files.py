import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from vitac.envs.fem.model.mesh import GelMesh, MeshError
from vitac.envs.tactile.gel import gelsight_mini_mesh
from vitac.envs.tactile.gel_files import GelFilesError, read_gel, read_gmsh


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
