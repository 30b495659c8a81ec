import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from vitac.envs.fem.model.mesh import MeshError, SurfaceMesh
from vitac.envs.geometry.pegs import PegShape, hole_surface
from vitac.envs.geometry.stl import StlError, read_stl


def binary_stl(mesh: SurfaceMesh) -> bytes:
    corners = (mesh.vertices_m[mesh.triangles] * 1e3).astype("<f4")
    records = b"".join(struct.pack("<3f", 0, 0, 0) + triangle.tobytes() + b"\0\0" for triangle in corners)
    # Many writers start a binary header with "solid", too.
    return b"solid written by hand".ljust(80) + struct.pack("<I", len(corners)) + records


def ascii_stl(mesh: SurfaceMesh) -> bytes:
    lines = ["solid made"]
    for triangle in mesh.vertices_m[mesh.triangles] * 1e3:
        lines += ["facet normal 0 0 0", "outer loop", *(f"vertex {x:.9g} {y:.9g} {z:.9g}" for x, y, z in triangle)]
        lines += ["endloop", "endfacet"]
    return "\n".join([*lines, "endsolid made"]).encode()


@pytest.mark.parametrize("written", [binary_stl, ascii_stl])
def test_reads_what_was_written(written: Callable[[SurfaceMesh], bytes], tmp_path: Path) -> None:
    mesh = hole_surface(PegShape.CONCAVE1)
    path = tmp_path / "hole.STL"
    path.write_bytes(written(mesh))
    read = read_stl(path)
    assert (len(read.vertices_m), len(read.triangles)) == (24, 48)
    assert read.name == "hole.STL"
    ours, theirs = mesh.vertices_m[mesh.triangles], read.vertices_m[read.triangles]
    assert np.abs(ours - theirs).max() < 1e-8


def test_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(StlError, match=r"Expected an STL file at .*absent\.STL.*No such file"):
        read_stl(tmp_path / "absent.STL")


def test_truncated_binary_file_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "cut.STL"
    path.write_bytes(binary_stl(hole_surface(PegShape.CUBOID)).replace(b"solid", b"other")[:-10])
    with pytest.raises(StlError, match="truncated"):
        read_stl(path)


@pytest.mark.parametrize("content", [b"", b"\x00" * 500, b"\x89PNG\r\n"])
def test_other_content_is_refused(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "junk.STL"
    path.write_bytes(content)
    with pytest.raises(StlError, match="not an STL file"):
        read_stl(path)


@pytest.mark.parametrize(
    "body", ["solid\nvertex 1 2 x\nendsolid", "solid\nvertex 1 2 3\nendsolid", "solid\nendsolid", "solid\nvertex 1 2"]
)
def test_malformed_ascii_file_is_refused(body: str, tmp_path: Path) -> None:
    path = tmp_path / "bad.stl"
    path.write_text(body)
    with pytest.raises(StlError, match=r"bad\.stl"):
        read_stl(path)


def test_open_surface_is_refused(tmp_path: Path) -> None:
    mesh = hole_surface(PegShape.CUBOID)
    content = binary_stl(mesh)
    count = len(mesh.triangles) - 1
    path = tmp_path / "open.STL"
    path.write_bytes(content[:80] + struct.pack("<I", count) + content[84 : 84 + 50 * count])
    with pytest.raises(MeshError, match="open at the edge"):
        read_stl(path)


def test_too_large_a_file_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "large.STL"
    path.write_bytes(b"solid" * 100)
    monkeypatch.setattr("vitac.envs.geometry.stl._LARGEST_FILE_BYTES", 100)
    with pytest.raises(StlError, match="at most 100"):
        read_stl(path)
