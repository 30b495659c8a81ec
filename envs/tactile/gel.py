"""Our own structured tetrahedral mesh of the GelSight Mini elastomer (challenge-facts 1.5, docs/gel-mesh.md)."""

from dataclasses import dataclass
from functools import cache
from itertools import product

import numpy as np
from numpy.typing import NDArray

from ..fem.mesh import GelMesh

MILLIMETRE_M = 1e-3


@dataclass(frozen=True, kw_only=True)
class GelDimensions:
    """A box with a bevelled upper rim; frame: origin at the centre of the bounding box, z out of the sensing face.

    Attributes:
        length_mm: extent along x.
        width_mm: extent along y.
        thickness_mm: extent along z.
        bevel_height_mm: how far below the sensing face the bevel begins.
        bevel_inset_mm: how far the sensing face stands back from the walls on each side.
    """

    length_mm: float = 25.25
    width_mm: float = 20.75
    thickness_mm: float = 4.0
    bevel_height_mm: float = 1.0
    bevel_inset_mm: float = 3.0


# Cells between the bevels along x and y; with one more for each bevel both counts are even, as the pattern needs.
SENSING_CELLS = (6, 6)

# Corners (x, y, z) of a cell's central tetrahedron, whose upper edge runs along the diagonal x = y; the other four
# tetrahedra cut off the remaining corners. Neighbouring cells use the mirrored choice, so their faces match.
_RISING = ((0, 0, 1), (1, 1, 1), (1, 0, 0), (0, 1, 0))
_FALLING = ((0, 0, 0), (1, 1, 0), (1, 0, 1), (0, 1, 1))


@cache
def gelsight_mini_mesh() -> GelMesh:
    """Mesh of the elastomer every 2025 task uses: 162 nodes, 320 tetrahedra, 81 driven and 49 sensing nodes.

    One layer of hexahedral cells spans the thickness: 6 x 6 between back and sensing face, and a ring of cells below
    the bevel, so that walls and bevel planes are met exactly. Each cell is cut into five tetrahedra, mirrored from cell
    to cell like a chessboard; the mesh is symmetric about both vertical mid planes, and in the corner cells the cut
    runs along the edge where two bevel planes meet.
    """
    size = GelDimensions()
    x_mm = _grid_lines(size.length_mm, size.bevel_inset_mm, SENSING_CELLS[0])
    y_mm = _grid_lines(size.width_mm, size.bevel_inset_mm, SENSING_CELLS[1])
    columns = len(x_mm) * len(y_mm)
    grid = np.array([(x, y) for y, x in product(y_mm, x_mm)])
    inner = np.array(
        [0 < i < len(x_mm) - 1 and 0 < j < len(y_mm) - 1 for j, i in product(range(len(y_mm)), range(len(x_mm)))]
    )
    top_mm = 0.5 * size.thickness_mm
    upper_z_mm = np.where(inner, top_mm, top_mm - size.bevel_height_mm)
    nodes_mm = np.concatenate([np.column_stack([grid, np.full(columns, -top_mm)]), np.column_stack([grid, upper_z_mm])])
    nowhere = np.zeros(columns, dtype=np.bool_)
    return GelMesh(
        rest_position_m=nodes_mm * MILLIMETRE_M,
        tetrahedra=_oriented(nodes_mm, _cut_cells(len(x_mm), len(y_mm))),
        driven=np.concatenate([~nowhere, nowhere]),
        sensing=np.concatenate([nowhere, inner]),
        name="generated GelSight Mini gel",
    )


def _grid_lines(extent_mm: float, inset_mm: float, cells: int) -> NDArray[np.float64]:
    """Grid coordinates along one axis: the wall, equal cells between the bevels, the other wall."""
    edge_mm = 0.5 * extent_mm
    between = np.linspace(-(edge_mm - inset_mm), edge_mm - inset_mm, cells + 1)
    return np.concatenate([[-edge_mm], between, [edge_mm]])


def _cut_cells(x_lines: int, y_lines: int) -> NDArray[np.int64]:
    """Five tetrahedra for every cell between the lower and the upper layer of grid nodes, shape [t, 4]."""

    def node(i: int, j: int, layer: int) -> int:
        return layer * x_lines * y_lines + j * x_lines + i

    tetrahedra = []
    for j, i in product(range(y_lines - 1), range(x_lines - 1)):
        centre, outer = (_RISING, _FALLING) if (i + j) % 2 == 0 else (_FALLING, _RISING)
        cells = [centre, *((corner, *_neighbours(corner)) for corner in outer)]
        tetrahedra += [[node(i + x, j + y, z) for x, y, z in cell] for cell in cells]
    return np.array(tetrahedra, dtype=np.int64)


def _neighbours(corner: tuple[int, int, int]) -> tuple[tuple[int, int, int], ...]:
    """The three corners of a cell that share an edge with this one."""
    x, y, z = corner
    return (1 - x, y, z), (x, 1 - y, z), (x, y, 1 - z)


def _oriented(nodes: NDArray[np.float64], tetrahedra: NDArray[np.int64]) -> NDArray[np.int64]:
    """The tetrahedra with two corners swapped where that makes the volume positive."""
    a, b, c = (nodes[tetrahedra[:, k]] - nodes[tetrahedra[:, 0]] for k in (1, 2, 3))
    negative = (np.cross(a, b) * c).sum(axis=1) < 0
    turned = tetrahedra.copy()
    turned[negative, 2:] = tetrahedra[negative, :1:-1]
    return turned
