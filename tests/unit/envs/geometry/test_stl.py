import re
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from vitac.envs.fem.model.mesh import MeshError, SurfaceMesh
from vitac.envs.geometry.pegs import PegShape, hole_surface
from vitac.envs.geometry.stl import StlError, read_corners, read_stl


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


def written_by_others() -> dict[str, bytes]:
    """One cube in many spellings."""
    mesh = hole_surface(PegShape.CUBOID)
    binary, text = binary_stl(mesh), ascii_stl(mesh)
    first, second = text.split(b"endfacet", 3)[:2], text.split(b"endfacet", 3)[2:]
    halves = b"endfacet".join(first) + b"endfacet\nendsolid made\nsolid next one" + b"endfacet".join(second)
    exponents = text.replace(b"vertex ", b"vertex +").replace(b"+-", b"-")
    return {
        "trailing bytes": binary + b"\r\n",
        "trailing padding": binary + b"\0" * 200,
        "header without solid": b"\0" * 80 + binary[80:],
        "capitals": text.upper(),
        "byte order mark": b"\xef\xbb\xbf" + text,
        "16 bits": text.decode().encode("utf-16"),
        "line ends of Windows": text.replace(b"\n", b"\r\n"),
        "line ends of old Macs": text.replace(b"\n", b"\r"),
        "one line": text.replace(b"\n", b" "),
        "tabs": text.replace(b" ", b"\t"),
        "name with spaces": text.replace(b"solid made", b"solid a vertex 1 2 3 of mine (v2)"),
        "no name": text.replace(b"solid made", b"solid"),
        "several solids": halves,
        "signs": exponents,
        "padding after text": text + b"\n\x1a\0\0",
        "exponents": re.sub(rb"(vertex|(?<=\d)) (-?\d+)(?=\.| |\n)(?!\.)", rb"\1 \g<2>.0E+00", text),
        "exponents of Fortran": re.sub(rb"(?<=vertex )(-?\d+)(?= )", rb"\g<1>.0D+00", text),
    }


@pytest.mark.parametrize("name", written_by_others())
def test_reads_what_others_write(name: str, tmp_path: Path) -> None:
    mesh = hole_surface(PegShape.CUBOID)
    path = tmp_path / "gel.stl"
    path.write_bytes(written_by_others()[name])
    expected = (mesh.vertices_m[mesh.triangles] * 1e3).reshape(-1, 3, 3)
    assert np.abs(read_corners(path) - expected).max() < 1e-5


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        (b"PK\x03\x04" + b"\1" * 200, r"begins with b'PK"),
        (
            binary_stl(hole_surface(PegShape.CUBOID)) + b"x" * 50,
            r"number of triangles, here \d+, and 50 bytes for each",
        ),
        (b"solid\nfacet\nouter loop\nvertex 1,5 2 3\nvertex 0 0 0\nvertex 0 1 0\nendsolid", "decimal points"),
        (b"solid\n" + b"facet\nouter loop\n" + b"vertex 1 2 3\n" * 4 + b"endloop\n", "three vertices"),
        (b"solid\n" + (b"facet\nouter loop\n" + b"vertex 1 2 3\n" * 4) * 3, "12 such vertices .* in 3 facets"),
        (b"solid\nouter loop\n" + b"vertex 1 2 3\n" * 3 + b"outer loop\nvertex 1", "3 such vertices after 4"),
    ],
)
def test_what_is_odd_is_said(content: bytes, problem: str, tmp_path: Path) -> None:
    path = tmp_path / "gel.stl"
    path.write_bytes(content)
    with pytest.raises(StlError, match=problem):
        read_corners(path)


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
