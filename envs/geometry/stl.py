"""Reader of STL files, binary and ASCII: the challenge's own solids given by `assets_dir`, and gels of participants."""

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from vitac.errors import VitacError

from ..fem.model.mesh import SurfaceMesh
from ..untrusted_file import read_start

_HEADER_BYTES = 80
_RECORD = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_LARGEST_FILE_BYTES = 64 * 2**20
_VERTEX_WORD = re.compile(rb"(?<!\S)vertex(?!\S)", re.IGNORECASE)
_VERTEX = re.compile(rb"(?<!\S)vertex\s+(\S+)\s+(\S+)\s+(\S+)", re.IGNORECASE)
_LOOP_WORD = re.compile(rb"(?<!\S)outer\s+loop(?!\S)", re.IGNORECASE)
# The name of a solid may hold any words, and ends with its line or its first facet.
_NAME = re.compile(rb"(?<!\S)(?:end)?solid(?!\S)[^\r\n]*?(?=(?<!\S)facet(?!\S)|[\r\n]|\Z)", re.IGNORECASE)
_TEXT_START = re.compile(rb"(?:\xef\xbb\xbf)?\s*solid(?!\S)", re.IGNORECASE)
_UTF_16 = (b"\xff\xfe", b"\xfe\xff")
_PADDING = b"\0\x1a\t\n\r "


class StlError(VitacError):
    """An STL file cannot be read; the message names the file, what was expected and what it is."""


class TooManyTriangles(StlError):
    """An STL file has more triangles than allowed; export it with fewer."""


def read_stl(path: Path) -> SurfaceMesh:
    """Read the closed surface in an STL file; corners at equal positions become one vertex, in order of appearance.

    Args:
        path: binary or ASCII file, in millimetres as the challenge's solids are.

    Raises:
        StlError: the file is missing, too large, truncated or not STL.
        MeshError: the triangles do not form a closed solid.
    """
    corners = read_corners(path)
    unique, first, inverse = np.unique(corners.reshape(-1, 3), axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first)
    rank = np.empty(len(order), dtype=np.int64)
    rank[order] = np.arange(len(order))
    return SurfaceMesh(
        vertices_m=np.ascontiguousarray(unique[order] * 1e-3),
        triangles=rank[inverse.reshape(-1)].reshape(-1, 3),
        name=path.name,
    )


def read_corners(path: Path, *, max_bytes: int | None = None, max_triangles: int | None = None) -> NDArray[np.float64]:
    """Return the triangles' corners of an untrusted STL file in its own unit, shape [f, 3, 3]; any may be non-finite.

    Args:
        path: binary or ASCII file.
        max_bytes: larger files are refused before they are read; 64 MiB by default.
        max_triangles: more are refused before they are parsed; any number by default.

    Raises:
        StlError: the file is missing, too large, truncated or not STL.
        TooManyTriangles: it has more triangles.
    """
    content = _content(path, _LARGEST_FILE_BYTES if max_bytes is None else max_bytes)
    if content.startswith(_UTF_16):
        content = content.decode("utf-16", "replace").encode()
    corners = _binary_corners(content, path)
    if corners is None:
        return _ascii_corners(content, path, max_triangles)
    _check_count(path, len(corners), max_triangles)
    return corners.astype(np.float64)


def _check_count(path: Path, triangles: int, max_triangles: int | None) -> None:
    if max_triangles is not None and triangles > max_triangles:
        raise TooManyTriangles(
            f"{path} has {triangles} triangles, expected at most {max_triangles}; export it coarser."
        )


def _content(path: Path, max_bytes: int) -> bytes:
    try:
        content = read_start(path, max_bytes)
    except OSError as error:
        raise StlError(f"Expected an STL file at {path}, but it cannot be read: {error.strerror}.") from error
    if len(content) > max_bytes:
        raise StlError(f"{path} is too large, expected an STL file of at most {max_bytes} bytes.")
    return content


def _binary_corners(content: bytes, path: Path) -> NDArray[np.float32] | None:
    """Return the triangles' corners of a binary file, shape [f, 3, 3], or None where it is text.

    Fewer bytes than a triangle has, or only padding, may follow the last one.
    """
    records = content[_HEADER_BYTES + 4 :]
    count = int.from_bytes(content[_HEADER_BYTES : _HEADER_BYTES + 4], "little")
    expected = count * _RECORD.itemsize
    fits = count > 0 and len(records) == expected
    if not fits and _TEXT_START.match(content) and b"\0" not in content.rstrip(_PADDING):
        return None
    surplus = len(records) - expected
    if count == 0 or surplus < 0 or (surplus >= _RECORD.itemsize and records[expected:].strip(_PADDING)):
        raise StlError(
            f"{path} is not an STL file that can be read: it has {len(content)} bytes and begins with "
            f"{content[:12]!r}. Expected text from 'solid' on, or after a header of {_HEADER_BYTES} bytes the number "
            f"of triangles, here {count}, and {_RECORD.itemsize} bytes for each, {_HEADER_BYTES + 4 + expected} in "
            "all; is it truncated?"
        )
    corners: NDArray[np.float32] = np.frombuffer(records, dtype=_RECORD, count=count)["corners"]
    return corners


def _ascii_corners(content: bytes, path: Path, max_triangles: int | None) -> NDArray[np.float64]:
    text = _NAME.sub(b"", content)
    announced = sum(1 for _ in _VERTEX_WORD.finditer(text))
    _check_count(path, announced // 3, max_triangles)
    values = [[_number(word, path) for word in vertex.groups()] for vertex in _VERTEX.finditer(text)]
    loops = sum(1 for _ in _LOOP_WORD.finditer(text))
    if not values or len(values) % 3 or len(values) != announced or loops not in (0, len(values) // 3):
        raise StlError(
            f"{path}: expected facets of three vertices with three numbers each, got {len(values)} such vertices after "
            f"{announced} words 'vertex' in {loops} facets; export triangles, and the whole file."
        )
    return np.array(values, dtype=np.float64).reshape(-1, 3, 3)


def _number(word: bytes, path: Path) -> float:
    """Return a number, with an exponent after e or, as Fortran writes it, d."""
    try:
        return float(word.lower().replace(b"d", b"e"))
    except ValueError:
        hint = "write decimal points, no commas" if b"," in word else "export it again"
        raise StlError(f"{path}: expected three numbers after 'vertex', got {word!r:.60}; {hint}.") from None
