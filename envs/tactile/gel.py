"""Gels: the challenge's one generated from its dimensions, how thick a gel is, and a reader of the challenge's meshes.

The meshes, for `assets_dir`, are Gmsh 4.1 ASCII `tet.msh` files with their node lists.
"""

import json
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from itertools import product
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from vitac.errors import VitacError

from ..fem.model.mesh import GelMesh
from ..untrusted_file import read_start

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]


MILLIMETRE_M = 1e-3
# Height of the sensing face's highest point in the frame of a gel made here.
SENSING_HEIGHT_MM = 2.0
# Cells between the bevels of the gel for training, along x and along y.
COARSE_CELLS = 4


@dataclass(frozen=True, kw_only=True)
class GelDimensions:
    """A box with a bevelled upper rim; frame: z out of the sensing face, which is at z = 2 mm, x and y centred.

    Attributes:
        length_mm: extent along x.
        width_mm: extent along y.
        thickness_mm: extent along z.
        bevel_height_mm: how far below the sensing face the bevel ends.
        bevel_inset_mm: how far the sensing face stands back from the walls on each side.
        dome_mm: how far the sensing face falls from its centre to its rim; 0 is flat.
    """

    length_mm: float = 25.25
    width_mm: float = 20.75
    thickness_mm: float = 4.0
    bevel_height_mm: float = 1.0
    bevel_inset_mm: float = 3.0
    dome_mm: float = 0.0


@dataclass(frozen=True, kw_only=True)
class GelCells:
    """Hexahedral cells of a structured gel.

    Attributes:
        x: between the bevels along x.
        y: between the bevels along y.
        bevel: across each bevel.
        layers: through the thickness.
        growth: by which factor a cell between the bevels is longer than its neighbour towards the middle.
        is_hexahedral: whether a cell is one hexahedron, which does not lock, or five tetrahedra.
    """

    x: int = 6
    y: int = 6
    bevel: int = 1
    layers: int = 1
    growth: float = 1.0
    is_hexahedral: bool = False


# Corners (x, y, z) of a cell's central tetrahedron, whose upper edge runs along the diagonal x = y; the other four
# tetrahedra cut off the remaining corners. Neighbouring cells use the mirrored choice, so their faces match.
_RISING = ((0, 0, 1), (1, 1, 1), (1, 0, 0), (0, 1, 0))
_FALLING = ((0, 0, 0), (1, 1, 0), (1, 0, 1), (0, 1, 1))


@cache
def gelsight_mini_mesh() -> GelMesh:
    """Return the mesh of the elastomer every 2025 task uses: 162 nodes, 320 tetrahedra, 81 driven and 49 sensing nodes.

    One layer of hexahedral cells spans the thickness: 6 x 6 between back and sensing face, and a ring of cells below
    the bevel, so that walls and bevel planes are met exactly. The numbers of cells along x and y are even, so the mesh
    is symmetric about both vertical mid planes, and in the corner cells the cut runs along the edge where two bevel
    planes meet.
    """
    return structured_gel(name="generated GelSight Mini gel")


@cache
def coarse_gelsight_mini_mesh() -> GelMesh:
    """Return the same elastomer in fewer elements, for training; see `gelsight_mini_mesh`."""
    return structured_gel(name="coarse GelSight Mini gel", cells=GelCells(x=COARSE_CELLS, y=COARSE_CELLS))


@cache
def arena_gel_mesh() -> GelMesh:
    """Return the mesh of the elastomer under `arena-2`: 363 nodes, 200 hexahedra, 121 driven and 81 sensing nodes.

    Two layers, finest in the middle, and as symmetric as `gelsight_mini_mesh`.
    """
    cells = GelCells(x=8, y=8, layers=2, growth=1.3, is_hexahedral=True)
    return structured_gel(name="hexahedral GelSight Mini gel", cells=cells)


@cache
def coarse_arena_gel_mesh() -> GelMesh:
    """Return the same elastomer in fewer hexahedra, for training; see `arena_gel_mesh`."""
    cells = GelCells(x=COARSE_CELLS, y=COARSE_CELLS, layers=2, is_hexahedral=True)
    return structured_gel(name="coarse hexahedral GelSight Mini gel", cells=cells)


def structured_gel(*, name: str, size: GelDimensions | None = None, cells: GelCells | None = None) -> GelMesh:
    """Return a gel of hexahedral cells, each cut into five tetrahedra, mirrored from cell to cell like a chessboard.

    The back face is driven, the face between the bevels is sensing.
    """
    size, cells = size or GelDimensions(), cells or GelCells()
    x_mm, x_rise = _grid_lines(size.length_mm, size.bevel_inset_mm, cells.x, cells)
    y_mm, y_rise = _grid_lines(size.width_mm, size.bevel_inset_mm, cells.y, cells)
    grid = np.array([(x, y) for y, x in product(y_mm, x_mm)])
    rise = np.array([min(x, y) for y, x in product(y_rise, x_rise)])
    bottom_mm = SENSING_HEIGHT_MM - size.thickness_mm
    upper_z_mm = SENSING_HEIGHT_MM - size.dome_mm * (1.0 - _dome(grid, size)) - size.bevel_height_mm * (1.0 - rise)
    layers = [bottom_mm + (layer / cells.layers) * (upper_z_mm - bottom_mm) for layer in range(cells.layers)]
    nodes_mm = np.concatenate([np.column_stack([grid, z_mm]) for z_mm in (*layers, upper_z_mm)])
    inside = np.zeros((cells.layers + 1, len(grid)), dtype=np.bool_)
    driven, sensing = inside.copy(), inside.copy()
    driven[0] = True
    sensing[-1] = rise == 1.0
    corners = _cell_corners(len(x_mm), len(y_mm), cells.layers)
    return GelMesh(
        rest_position_m=nodes_mm * MILLIMETRE_M,
        tetrahedra=_oriented(nodes_mm, _cut_cells(len(x_mm), len(y_mm), cells.layers)),
        driven=driven.ravel(),
        sensing=sensing.ravel(),
        name=name,
        hexahedra=corners if cells.is_hexahedral else corners[:0],
    )


def _grid_lines(extent_mm: float, inset_mm: float, count: int, cells: GelCells) -> tuple[FloatArray, FloatArray]:
    """Return the grid coordinates along one axis from wall to wall, and how high up the bevel each is, from 0 to 1.

    There are `count` cells between the bevels.
    """
    edge_mm = 0.5 * extent_mm
    half_mm = edge_mm - inset_mm
    between = np.linspace(-half_mm, half_mm, count + 1)
    if cells.growth != 1.0:
        lengths = _powers(cells.growth, np.abs(2 * np.arange(count) - (count - 1)) // 2)
        ends = np.concatenate([[0.0], np.cumsum(lengths)])
        between = half_mm * (ends - ends[::-1]) / ends[-1]
    rise = np.arange(cells.bevel) / cells.bevel
    outer = -edge_mm + inset_mm * rise
    return np.concatenate([outer, between, -outer[::-1]]), np.concatenate([rise, np.ones(count + 1), rise[::-1]])


def _powers(base: float, exponents: IndexArray) -> FloatArray:
    """Return powers by multiplication: the C library's pow may give other bits on another machine."""
    table = np.cumprod(np.concatenate([[1.0], np.full(exponents.max(), base)]))
    return np.asarray(table[exponents])


def _dome(grid_mm: FloatArray, size: GelDimensions) -> FloatArray:
    """Return the height of a dome over the sensing face: 1 at its centre, 0 at its rim and beyond."""
    half_mm = 0.5 * np.array([size.length_mm, size.width_mm]) - size.bevel_inset_mm
    return np.asarray(np.maximum(1.0 - (grid_mm / half_mm) ** 2, 0.0).prod(axis=1))


def _cell_corners(x_lines: int, y_lines: int, layers: int) -> IndexArray:
    """Return the nodes of every cell between the layers of grid nodes, x fastest, shape [c, 8]."""
    number = np.arange((layers + 1) * y_lines * x_lines).reshape(layers + 1, y_lines, x_lines)
    corners = [
        number[z : layers + z, y : y_lines - 1 + y, x : x_lines - 1 + x].ravel()
        for z, y, x in product(range(2), repeat=3)
    ]
    return np.stack(corners, axis=1)


def _cut_cells(x_lines: int, y_lines: int, layers: int) -> NDArray[np.int64]:
    """Return five tetrahedra for every cell between the layers of grid nodes, shape [t, 4]."""

    def node(i: int, j: int, layer: int) -> int:
        return layer * x_lines * y_lines + j * x_lines + i

    tetrahedra = []
    for layer, j, i in product(range(layers), range(y_lines - 1), range(x_lines - 1)):
        centre, outer = (_RISING, _FALLING) if (i + j + layer) % 2 == 0 else (_FALLING, _RISING)
        cells = [centre, *((corner, *_neighbours(corner)) for corner in outer)]
        tetrahedra += [[node(i + x, j + y, layer + z) for x, y, z in cell] for cell in cells]
    return np.array(tetrahedra, dtype=np.int64)


def _neighbours(corner: tuple[int, int, int]) -> tuple[tuple[int, int, int], ...]:
    """Return the three corners of a cell that share an edge with this one."""
    x, y, z = corner
    return (1 - x, y, z), (x, 1 - y, z), (x, y, 1 - z)


def _oriented(nodes: NDArray[np.float64], tetrahedra: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the tetrahedra with two corners swapped where that makes the volume positive."""
    a, b, c = (nodes[tetrahedra[:, k]] - nodes[tetrahedra[:, 0]] for k in (1, 2, 3))
    negative = (np.cross(a, b) * c).sum(axis=1) < 0
    turned = tetrahedra.copy()
    turned[negative, 2:] = tetrahedra[negative, :1:-1]
    return turned


SENSING_NODES, ARENA_SENSING_NODES = 49, 81
"""Nodes on the sensing face of the gel of the evaluations, and of that under `arena-2`."""


MARKER_COUNT = 128
"""Markers in a marker flow; where fewer are seen the last is repeated."""


# From the camera's optical centre to the back face of the gel, for every sensor.
EYE_TO_BACK_MM = 18.0
# Heights are rounded to this many decimals of a millimetre, since meshes in files are.
_DECIMALS = 6


def highest_mm(gel: GelMesh) -> float:
    """Return the height of the gel's highest point above the origin of its frame [mm]."""
    return round(float(gel.rest_position_m[:, 2].max()) * 1e3, _DECIMALS)


def eye_distance_m(gel: GelMesh) -> float:
    """Return the distance of the camera behind the origin of the gel's frame [m]: 20 mm for the challenge's gel."""
    back_mm = round(float(gel.rest_position_m[gel.driven_nodes, 2].min()) * 1e3, _DECIMALS)
    return (EYE_TO_BACK_MM - back_mm) * 1e-3


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
