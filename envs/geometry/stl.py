"""Reader of STL files, binary and ASCII: the challenge's own solids given by `assets_dir`, and gels of participants."""

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..errors import VitacError
from ..fem.model.mesh import SurfaceMesh
from ..untrusted_file import read_start

_HEADER_BYTES = 80
_RECORD = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_LARGEST_FILE_BYTES = 64 * 2**20
_VERTEX_WORD = re.compile(rb"(?<!\S)vertex(?!\S)")
_VERTEX = re.compile(rb"(?<!\S)vertex\s+(\S+)\s+(\S+)\s+(\S+)")


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
    corners = _binary_corners(content)
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


def _binary_corners(content: bytes) -> NDArray[np.float32] | None:
    """Return triangle corners, shape [f, 3, 3], or None where the length does not fit a binary file's count."""
    if len(content) < _HEADER_BYTES + 4:
        return None
    count = int.from_bytes(content[_HEADER_BYTES : _HEADER_BYTES + 4], "little")
    if count == 0 or len(content) != _HEADER_BYTES + 4 + count * _RECORD.itemsize:
        return None
    records = np.frombuffer(content, dtype=_RECORD, offset=_HEADER_BYTES + 4)
    corners: NDArray[np.float32] = records["corners"]
    return corners


def _ascii_corners(content: bytes, path: Path, max_triangles: int | None) -> NDArray[np.float64]:
    if not content.lstrip().startswith(b"solid"):
        raise StlError(
            f"{path} is not an STL file: it neither starts with 'solid' (ASCII) nor has the length that the triangle "
            f"count in a binary header demands (got {len(content)} bytes); is it truncated?"
        )
    announced = sum(1 for _ in _VERTEX_WORD.finditer(content))
    _check_count(path, announced // 3, max_triangles)
    try:
        values = [[float(word) for word in found.groups()] for found in _VERTEX.finditer(content)]
    except ValueError as error:
        raise StlError(f"{path}: a 'vertex' must be followed by three numbers ({error!s:.120}).") from error
    if not values or len(values) % 3 or len(values) != announced:
        raise StlError(f"{path}: expected a multiple of three vertices of three numbers, got {len(values)} vertices.")
    return np.array(values, dtype=np.float64).reshape(-1, 3, 3)
