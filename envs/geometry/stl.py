"""Reader of STL files, binary and ASCII. Used for the challenge's own solids given by `assets_dir`."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..errors import VitacError
from ..fem.model.mesh import SurfaceMesh

_HEADER_BYTES = 80
_RECORD = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_LARGEST_FILE_BYTES = 64 * 2**20


class StlError(VitacError):
    """An STL file cannot be read; the message names the file, what was expected and what it is."""


def read_stl(path: Path, *, scale: float = 1e-3) -> SurfaceMesh:
    """Read the closed surface in an STL file; corners at equal positions become one vertex, in order of appearance.

    Args:
        path: binary or ASCII file.
        scale: metres per unit of the file; STL has no unit, the challenge's solids are in millimetres.

    Raises:
        StlError: the file is missing, too large, truncated or not STL.
        MeshError: the triangles do not form a closed solid.
    """
    content = _content(path)
    corners = _binary_corners(content)
    if corners is None:
        corners = _ascii_corners(content, path)
    unique, first, inverse = np.unique(corners.reshape(-1, 3), axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first)
    rank = np.empty(len(order), dtype=np.int64)
    rank[order] = np.arange(len(order))
    return SurfaceMesh(
        vertices_m=np.ascontiguousarray(unique[order] * scale),
        triangles=rank[inverse.reshape(-1)].reshape(-1, 3),
        name=path.name,
    )


def _content(path: Path) -> bytes:
    try:
        size = path.stat().st_size
        if size > _LARGEST_FILE_BYTES:
            raise StlError(f"{path} has {size} bytes, expected an STL file of at most {_LARGEST_FILE_BYTES}.")
        return path.read_bytes()
    except OSError as error:
        raise StlError(f"Expected an STL file at {path}, but it cannot be read: {error.strerror}.") from error


def _binary_corners(content: bytes) -> NDArray[np.float64] | None:
    """Triangle corners, shape [f, 3, 3], or None where the length is not the one that a binary file's count demands."""
    if len(content) < _HEADER_BYTES + 4:
        return None
    count = int.from_bytes(content[_HEADER_BYTES : _HEADER_BYTES + 4], "little")
    if count == 0 or len(content) != _HEADER_BYTES + 4 + count * _RECORD.itemsize:
        return None
    records = np.frombuffer(content, dtype=_RECORD, offset=_HEADER_BYTES + 4)
    return records["corners"].astype(np.float64)


def _ascii_corners(content: bytes, path: Path) -> NDArray[np.float64]:
    if not content.lstrip().startswith(b"solid"):
        raise StlError(
            f"{path} is not an STL file: it neither starts with 'solid' (ASCII) nor has the length that the triangle "
            f"count in a binary header demands (got {len(content)} bytes); is it truncated?"
        )
    words = content.split()
    starts = [i for i, word in enumerate(words) if word == b"vertex"]
    try:
        values = [[float(word) for word in words[i + 1 : i + 4]] for i in starts]
    except ValueError as error:
        raise StlError(f"{path}: a 'vertex' must be followed by three numbers ({error}).") from error
    if not values or len(values) % 3 or any(len(value) != 3 for value in values):
        raise StlError(f"{path}: expected a multiple of three vertices of three numbers, got {len(values)} vertices.")
    return np.array(values, dtype=np.float64).reshape(-1, 3, 3)
