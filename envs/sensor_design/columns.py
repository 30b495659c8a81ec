"""Tetrahedra between a base and heights over a plane mesh, which may jump across walls; called by `mesher`.

Over every point of the plane stands a column of nodes: the base, the heights of the faces that meet there, and nodes
between them. Every triangle spans a prism between the columns of its corners, filled from below: the next node of one
column makes a tetrahedron with the topmost nodes so far of all three. The nodes' ranks decide which column is next, so
that both prisms at a vertical face cut it alike; at a wall, all nodes of the lower side come before those above it.
"""

from collections import defaultdict
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from vitac.errors import VitacError

from .plane_mesh import Edge, Triangle

FloatArray = NDArray[np.float64]

# Heights at a point that differ by less are one.
_SAME_HEIGHT_MM = 0.02
# Between the ranks of nodes of which one has to come after the other.
_RANK_STEP = 1e-3


class WallsTangled(VitacError):
    """Walls of a gel cross or wind up on themselves; bring a tet.msh."""


@dataclass(kw_only=True)
class _Column:
    """Heights over one point.

    Attributes:
        levels_mm: distinct heights of the faces that meet here, ascending.
        level_of: index of the level of every triangle at this point.
        heights_mm: of the nodes from the base up.
        top: position of each level among the nodes.
        ranks: of the nodes; they rise with the column.
        first_node: number of the base's node; the others follow.
    """

    levels_mm: list[float] = field(default_factory=list)
    level_of: dict[int, int] = field(default_factory=dict)
    heights_mm: list[float] = field(default_factory=list)
    top: list[int] = field(default_factory=list)
    ranks: list[float] = field(default_factory=list)
    first_node: int = 0


class Columns:
    """Columns over the points of a plane mesh.

    Args:
        triangles: counter-clockwise, of the plane mesh.
        walls: edges across which the height may jump, smaller index first.
        corners_mm: x and y of the triangles' corners, shape [f, 3, 2].
        heights_mm: their heights as every triangle has them, shape [f, 3].
        spacing_mm: wanted between the nodes of a column.

    Raises:
        WallsTangled: no order of the nodes fits all walls.
    """

    def __init__(
        self,
        triangles: list[Triangle],
        walls: set[Edge],
        *,
        corners_mm: FloatArray,
        heights_mm: FloatArray,
        spacing_mm: float,
    ) -> None:
        self._triangles = triangles
        self._corners_mm = corners_mm
        self._columns: dict[int, _Column] = {}
        self._of_edge = {
            (triangle[i], triangle[(i + 1) % 3]): number for number, triangle in enumerate(triangles) for i in range(3)
        }
        around: dict[int, dict[int, float]] = defaultdict(dict)
        for number, triangle in enumerate(triangles):
            for corner, height in zip(triangle, heights_mm[number].tolist(), strict=True):
                around[corner][number] = height
        self._n_nodes = 0
        for point in sorted(around):
            self._columns[point] = self._column(point, around[point], walls, spacing_mm)
        self._rank(walls)

    def top_corners_mm(self) -> FloatArray:
        """Return the corners of the faces over all triangles [mm], shape [f, 3, 3]."""
        heights = [
            [self._columns[point].levels_mm[self._columns[point].level_of[number]] for point in triangle]
            for number, triangle in enumerate(self._triangles)
        ]
        return np.concatenate([self._corners_mm, np.array(heights)[:, :, None]], axis=2)

    def nodes(self) -> list[tuple[int, float]]:
        """Return all nodes as (point, height in mm)."""
        return [(point, height) for point, column in self._columns.items() for height in column.heights_mm]

    def tetrahedra(self) -> list[tuple[int, ...]]:
        """Return the positively oriented tetrahedra between the nodes."""
        return [cell for number in range(len(self._triangles)) for cell in self._prism(number)]

    def _column(self, point: int, heights: dict[int, float], walls: set[Edge], spacing_mm: float) -> _Column:
        column = _Column(first_node=self._n_nodes)
        fans = self._fans(point, heights, walls)
        means = [sum(heights[number] for number in fan) / len(fan) for fan in fans]
        for mean, fan in sorted(zip(means, fans, strict=True)):
            if not column.levels_mm or mean - column.levels_mm[-1] > _SAME_HEIGHT_MM:
                column.levels_mm.append(mean)
            for number in fan:
                column.level_of[number] = len(column.levels_mm) - 1
        _stack(column, spacing_mm)
        self._n_nodes += len(column.heights_mm)
        return column

    def _fans(self, point: int, heights: dict[int, float], walls: set[Edge]) -> list[list[int]]:
        """Return the triangles around a point, grouped by the walls between them."""
        fan_of = {number: number for number in heights}

        def find(number: int) -> int:
            while fan_of[number] != number:
                number = fan_of[number]
            return number

        for number in heights:
            corners = self._triangles[number]
            before = corners[corners.index(point) - 1]
            neighbour = self._of_edge.get((point, before))
            if neighbour is not None and (min(point, before), max(point, before)) not in walls:
                first, second = find(number), find(neighbour)
                fan_of[max(first, second)] = min(first, second)
        fans: dict[int, list[int]] = defaultdict(list)
        for number in sorted(heights):
            fans[find(number)].append(number)
        return list(fans.values())

    def _rank(self, walls: set[Edge]) -> None:
        """Rank the nodes by height, and raise those that have to come after others at a wall, until all fits."""
        rules: list[tuple[int, int, int, int]] = []
        for a, b in sorted(walls):
            if (a, b) in self._of_edge and (b, a) in self._of_edge:
                rules += self._rules(a, b)
        changed, rounds = True, 0
        while changed:
            changed = False
            for low, below, high, above in rules:
                needed = self._columns[low].ranks[below] + _RANK_STEP
                ranks = self._columns[high].ranks
                for position in range(above, len(ranks)):
                    if ranks[position] >= needed:
                        break
                    ranks[position], changed = needed, True
                    needed += _RANK_STEP
            rounds += 1
            if rounds > len(rules) + 1:
                raise WallsTangled("Walls wind up on themselves like a spiral staircase; bring a tet.msh.")

    def _rules(self, a: int, b: int) -> list[tuple[int, int, int, int]]:
        """Return (point, position, point, position) of nodes of which the second comes after the first, at one wall.

        All nodes above the lower side, at both ends, come after the lower side's own.
        """
        sides = [
            tuple(self._columns[point].top[self._columns[point].level_of[number]] for point in (a, b))
            for number in (self._of_edge[a, b], self._of_edge[b, a])
        ]
        lower = tuple(min(ends) for ends in zip(*sides, strict=True))
        if lower not in sides:
            raise WallsTangled("The faces on both sides of a wall cross along it; bring a tet.msh.")
        ends = list(zip((a, b), lower, strict=True))
        return [
            (low, below, high, above + 1)
            for low, below in ends
            for high, above in ends
            if above + 1 < len(self._columns[high].heights_mm)
        ]

    def _prism(self, number: int) -> list[tuple[int, ...]]:
        """Return the tetrahedra below one triangle's face."""
        columns = [self._columns[point] for point in self._triangles[number]]
        tops = [column.top[column.level_of[number]] for column in columns]
        reached, cells = [0, 0, 0], []
        while reached != tops:
            _, _, k = min(
                (columns[k].ranks[reached[k] + 1], self._triangles[number][k], k)
                for k in range(3)
                if reached[k] < tops[k]
            )
            corners = [column.first_node + position for column, position in zip(columns, reached, strict=True)]
            reached[k] += 1
            cells.append((*corners, columns[k].first_node + reached[k]))
        return cells


def _stack(column: _Column, spacing_mm: float) -> None:
    """Give a column its nodes: the base, its levels, and evenly spaced ones between them, ranked by height."""
    column.heights_mm, low = [0.0], 0.0
    for level in column.levels_mm:
        pieces = max(1, int((level - low) / spacing_mm + 0.5))
        column.heights_mm += [low + piece / pieces * (level - low) for piece in range(1, pieces)]
        column.heights_mm.append(level)
        column.top.append(len(column.heights_mm) - 1)
        low = level
    # A tetrahedron that reaches a node starts at the one below it: halfway between, both columns have come equally far.
    column.ranks = [0.0, *(0.5 * (a + b) for a, b in pairwise(column.heights_mm))]
