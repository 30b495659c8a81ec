"""Reader of the challenge's gel meshes: Gmsh 4.1 ASCII `tet.msh` with its node lists. Used for `assets_dir`."""

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from vitac.errors import VitacError

from ..fem.model.mesh import GelMesh
from ..untrusted_file import read_start

_TETRAHEDRON_TYPE = 4
_LARGEST_FILE_BYTES = 64 * 2**20


class GelFilesError(VitacError):
    """A gel folder cannot be used; the message names the file, what was expected and what it is."""


def read_gel(directory: Path) -> GelMesh:
    """Return the gel mesh of a folder that holds `meta_file`, the mesh in metres and its driven and sensing node lists.

    Raises:
        GelFilesError: a file is missing or is not what its name promises.
        MeshError: the mesh cannot be simulated.
    """
    names = _meta(directory / "meta_file")
    mesh_path = directory / names["tet_mesh"]
    positions_m, tetrahedra = read_gmsh(mesh_path)
    return GelMesh(
        rest_position_m=positions_m,
        tetrahedra=tetrahedra,
        driven=_mask(directory / names["active"], len(positions_m)),
        sensing=_mask(directory / names["on_surface"], len(positions_m)),
        name=f"{directory.name}/{mesh_path.name}",
    )


def read_gmsh(path: Path, *, max_bytes: int = _LARGEST_FILE_BYTES) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return nodes, shape [n, 3], and tetrahedra, shape [t, 4], of a Gmsh 4.1 ASCII file; skip other elements.

    Args:
        path: untrusted file.
        max_bytes: larger files are refused before they are read.

    Raises:
        GelFilesError: it is missing, too large, truncated, of another version, or holds no tetrahedra.
    """
    sections = _sections(_text(path, max_bytes), path)
    version = " ".join(sections.get("MeshFormat", ())[:2])
    if version != "4.1 0":
        raise GelFilesError(f"{path} is not Gmsh 4.1 ASCII: its format line begins '{version}', expected '4.1 0'.")
    for name in ("Nodes", "Elements"):
        if name not in sections:
            raise GelFilesError(f"{path} has no ${name} section; is it truncated?")
    try:
        tags, positions = _nodes(iter(sections["Nodes"]))
        tetrahedra = _tetrahedra(iter(sections["Elements"]))
    except (StopIteration, RuntimeError, ValueError) as error:
        raise GelFilesError(
            f"{path}: a section is shorter than its counts say or holds no numbers ({error})."
        ) from error
    if not tetrahedra:
        raise GelFilesError(
            f"{path} holds no tetrahedra (element type {_TETRAHEDRON_TYPE}); mesh the volume, not the surface."
        )
    number = {tag: index for index, tag in enumerate(tags)}
    try:
        corners = [[number[tag] for tag in corner_tags] for corner_tags in tetrahedra]
    except KeyError as error:
        raise GelFilesError(f"{path}: a tetrahedron names node {error}, which $Nodes does not list.") from error
    return np.array(positions, dtype=np.float64).reshape(-1, 3), np.array(corners, dtype=np.int64)


def _text(path: Path, max_bytes: int = _LARGEST_FILE_BYTES) -> str:
    try:
        content = read_start(path, max_bytes)
        if len(content) > max_bytes:
            raise GelFilesError(f"{path} is too large, expected at most {max_bytes} bytes.")
        return content.decode("ascii")
    except OSError as error:
        raise GelFilesError(f"Expected a gel file at {path}, but it cannot be read: {error.strerror}.") from error
    except UnicodeDecodeError as error:
        raise GelFilesError(f"{path} is not ASCII text ({error.reason} at byte {error.start}).") from error


def _meta(path: Path) -> dict[str, str]:
    try:
        names = json.loads(_text(path))
    except json.JSONDecodeError as error:
        raise GelFilesError(f"{path} is not JSON: {error}.") from error
    for key in ("tet_mesh", "active", "on_surface"):
        name = names.get(key) if isinstance(names, dict) else None
        if not isinstance(name, str) or Path(name).name != name:
            raise GelFilesError(f"{path}: expected a plain file name under '{key}', got {name!r}.")
    return dict(names)


def _mask(path: Path, nodes: int) -> NDArray[np.bool_]:
    words = _text(path).split()
    if len(words) != nodes or not set(words) <= {"0", "1"}:
        raise GelFilesError(f"{path}: expected a 0 or 1 for each of the {nodes} nodes, got {len(words)} words.")
    return np.array([word == "1" for word in words], dtype=np.bool_)


def _sections(text: str, path: Path) -> dict[str, list[str]]:
    """Return the words between every `$Name` and its `$EndName`."""
    sections: dict[str, list[str]] = {}
    name = None
    for line in text.splitlines():
        word = line.strip()
        if name is None and word.startswith("$"):
            name = word[1:]
            sections[name] = []
        elif name is not None and word == f"$End{name}":
            name = None
        elif name is not None:
            sections[name] += word.split()
    if name is not None:
        raise GelFilesError(f"{path}: the section ${name} is not closed; is the file truncated?")
    return sections


def _integers(words: Iterator[str], count: int) -> list[int]:
    return [int(next(words)) for _ in range(count)]


def _nodes(words: Iterator[str]) -> tuple[list[int], list[list[float]]]:
    blocks, total, _, _ = _integers(words, 4)
    tags, positions = [], []
    for _ in range(blocks):
        _, _, parametric, count = _integers(words, 4)
        if parametric:
            raise ValueError("parametric coordinates are not supported")
        tags += _integers(words, count)
        positions += [[float(next(words)) for _ in range(3)] for _ in range(count)]
    if len(tags) != total or len(set(tags)) != total:
        raise ValueError(f"{len(set(tags))} nodes in the blocks, {total} announced")
    return tags, positions


def _tetrahedra(words: Iterator[str]) -> list[list[int]]:
    """Return the node tags of all tetrahedra; the words of other elements are skipped by their known corner counts."""
    corners_of_type = {15: 1, 1: 2, 2: 3, 3: 4, _TETRAHEDRON_TYPE: 4}
    blocks = _integers(words, 4)[0]
    tetrahedra = []
    for _ in range(blocks):
        _, _, kind, count = _integers(words, 4)
        if kind not in corners_of_type:
            raise ValueError(f"element type {kind} is not supported, expected linear tetrahedra")
        rows = [_integers(words, 1 + corners_of_type[kind])[1:] for _ in range(count)]
        tetrahedra += rows if kind == _TETRAHEDRON_TYPE else []
    return tetrahedra
