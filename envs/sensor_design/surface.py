"""A triangle surface as somebody drew it, which may be anything, and the edges that show what is wrong with it.

Points on its triangles are where surfaces and heights are compared.
"""

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]


WELDS_MM = (1e-5, 1e-4, 1e-3)
"""Distances within which corners are one, tried in turn; single precision rounds those of a gel to some 1e-6 mm."""


@dataclass(frozen=True, kw_only=True, eq=False)
class DrawnSurface:
    """Triangles between numbered vertices; unlike `SurfaceMesh` neither closed nor oriented nor in metres.

    Attributes:
        vertices_mm: shape [v, 3].
        triangles: vertex indices, shape [f, 3]; no triangle names a vertex twice.
        weld_mm: corners at most so far apart along each axis were taken as one; 0 where none were.
    """

    vertices_mm: FloatArray
    triangles: IndexArray
    weld_mm: float = 0.0

    @classmethod
    def from_corners(cls, corners_mm: FloatArray) -> "DrawnSurface":
        """Return the surface of triangles with corners of shape [f, 3, 3].

        Corners that are close together become one vertex, by the smallest of `WELDS_MM` that leaves a closed surface
        without triangles lower than this, or only equal ones where none does. Triangles that then name a vertex twice
        or repeat another are left away. Where
        a triangle without height closes a T-junction, as CAD kernels write it, its neighbour is divided instead, which
        leaves the shape as it is.
        """
        vertices, index = np.unique(corners_mm.reshape(-1, 3), axis=0, return_inverse=True)
        drawn = cls(vertices_mm=vertices, triangles=index.reshape(-1, 3).astype(np.int64))
        tried = []
        for weld_mm in (*WELDS_MM, 0.0):
            tried.append(drawn.welded(weld_mm))
            if tried[-1].is_closed and not tried[-1].has_low_triangles:
                return tried[-1]
        return next((surface for surface in tried if surface.is_closed), tried[0])

    def welded(self, weld_mm: float) -> "DrawnSurface":
        """Return the surface with corners at most so far apart as one vertex, as `from_corners` says."""
        firsts = first_within(self.vertices_mm, weld_mm) if weld_mm else np.arange(len(self.vertices_mm))
        triangles = _single(firsts[self.triangles])
        used, index = np.unique(triangles, return_inverse=True)
        vertices_mm = self.vertices_mm[used]
        divided = _divided_at_t_junctions(vertices_mm, index.reshape(-1, 3).astype(np.int64), weld_mm)
        return DrawnSurface(vertices_mm=vertices_mm, triangles=divided, weld_mm=weld_mm)

    @cached_property
    def corners_mm(self) -> FloatArray:
        """Corners of the triangles [mm], shape [f, 3, 3]."""
        return self.vertices_mm[self.triangles]

    @cached_property
    def samples_mm(self) -> FloatArray:
        """Points of the surface, corners included, about 0.5 mm apart [mm], shape [n, 3]."""
        return samples_mm(self.corners_mm)

    @cached_property
    def area_vectors_mm2(self) -> FloatArray:
        """Outward normals of the triangles with the length of their areas [mm2], shape [f, 3]."""
        corners = self.corners_mm
        return np.asarray(0.5 * np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))

    @cached_property
    def areas_mm2(self) -> FloatArray:
        """Areas of the triangles [mm2], shape [f]."""
        return np.asarray(np.sqrt((self.area_vectors_mm2**2).sum(axis=1)))

    @cached_property
    def heights_mm(self) -> FloatArray:
        """Heights of the triangles over their longest edges [mm], shape [f]."""
        return heights_mm(self.corners_mm)

    @cached_property
    def is_low(self) -> NDArray[np.bool_]:
        """Whether each triangle is so low that rounding decides where it looks to, shape [f]."""
        return np.asarray(self.heights_mm <= WELDS_MM[-1])

    @cached_property
    def normals(self) -> FloatArray:
        """Outward unit normals, shape [f, 3]; a low triangle has that of its neighbour at the longest edge.

        On a surface on which exactly two triangles meet at each edge.
        """
        unit = self.area_vectors_mm2 / np.maximum(self.areas_mm2, 1e-300)[:, None]
        low = np.flatnonzero(self.is_low)
        if not len(low):
            return unit
        sides = np.roll(self.corners_mm, -1, axis=1) - self.corners_mm
        longest = (sides**2).sum(axis=2).argmax(axis=1)
        pairs = self.triangles_of_edges[self._edges[1][longest * len(unit) + np.arange(len(unit))]]
        source = np.arange(len(unit))
        source[low] = pairs[low].sum(axis=1) - low
        for _ in range(len(low).bit_length()):  # each time twice as far
            source = source[source]
        return np.asarray(unit[np.where(self.is_low[source], np.arange(len(unit)), source)])

    @cached_property
    def extent_mm(self) -> FloatArray:
        """Extent along x, y and z [mm], shape [3]."""
        return np.asarray(self.vertices_mm.max(axis=0) - self.vertices_mm.min(axis=0))

    @cached_property
    def volume_mm3(self) -> float:
        """Enclosed volume [mm3]; negative where the triangles are clockwise seen from outside."""
        return float(self._signed_volumes_mm3.sum())

    @cached_property
    def edges(self) -> IndexArray:
        """Undirected edges, each once, shape [e, 2]."""
        return self._edges[0]

    @property
    def open_edges(self) -> IndexArray:
        """Edges of a single triangle, shape [n, 2]."""
        return np.asarray(self.edges[self._uses.sum(axis=1) == 1])

    @property
    def mixed_edges(self) -> IndexArray:
        """Edges at which two triangles meet that are oriented against each other, shape [n, 2]."""
        return np.asarray(self.edges[((self._uses == 2) & (self._uses[:, ::-1] == 0)).any(axis=1)])

    @property
    def branching_edges(self) -> IndexArray:
        """Edges at which more than two triangles meet, shape [n, 2]."""
        return np.asarray(self.edges[self._uses.sum(axis=1) > 2])

    @property
    def is_closed(self) -> bool:
        """Whether two triangles meet at every edge."""
        return bool((self._uses.sum(axis=1) == 2).all())

    @property
    def has_low_triangles(self) -> bool:
        """Whether a triangle has a height of at most `weld_mm`."""
        return bool((self.heights_mm <= self.weld_mm).any())

    @cached_property
    def triangles_of_edges(self) -> IndexArray:
        """The two triangles at every edge of a surface on which exactly two meet at each, shape [e, 2]."""
        _, inverse, _ = self._edges
        order = np.argsort(inverse, kind="stable")
        return (order % len(self.triangles)).reshape(-1, 2)

    @cached_property
    def shells(self) -> IndexArray:
        """Number of the connected part that each triangle belongs to, from 0, shape [f]; parts share no edge."""
        label = np.arange(len(self.triangles))
        _, inverse, count = self._edges
        owner = np.tile(label, 3)
        while True:
            lowest = np.full(count, len(self.triangles))
            np.minimum.at(lowest, inverse, label[owner])
            smaller = label.copy()
            np.minimum.at(smaller, owner, lowest[inverse])
            smaller = smaller[smaller]
            if (smaller == label).all():
                return np.unique(label, return_inverse=True)[1].astype(np.int64)
            label = smaller

    def shell_volumes_mm3(self) -> FloatArray:
        """Return the enclosed volume of every shell [mm3], shape [s]."""
        return np.bincount(self.shells, weights=self._signed_volumes_mm3).astype(np.float64)

    @cached_property
    def _signed_volumes_mm3(self) -> FloatArray:
        # From the middle of the box: far from the origin the terms would cancel.
        corners = self.corners_mm - 0.5 * (self.vertices_mm.max(axis=0) + self.vertices_mm.min(axis=0))
        return np.asarray((np.cross(corners[:, 0], corners[:, 1]) * corners[:, 2]).sum(axis=1) / 6.0)

    @cached_property
    def _edges(self) -> tuple[IndexArray, IndexArray, int]:
        """Undirected edges, the edge of each directed one (first all of corner 0, then 1, then 2), and their number."""
        directed = self._directed
        key = directed.min(axis=1) * len(self.vertices_mm) + directed.max(axis=1)
        unique, inverse = np.unique(key, return_inverse=True)
        edges = np.column_stack(np.divmod(unique, len(self.vertices_mm)))
        return edges.astype(np.int64), inverse.reshape(-1).astype(np.int64), len(unique)

    @cached_property
    def _directed(self) -> IndexArray:
        return np.concatenate([self.triangles[:, [i, (i + 1) % 3]] for i in range(3)])

    @cached_property
    def _uses(self) -> IndexArray:
        """How often every edge is used upwards and downwards in vertex index, shape [e, 2]."""
        _, inverse, count = self._edges
        upward = self._directed[:, 0] < self._directed[:, 1]
        return np.column_stack([np.bincount(inverse[way], minlength=count) for way in (upward, ~upward)])


def first_within(points: FloatArray, distance: float) -> IndexArray:
    """Return for every point the first one that stands for it: at most so far from it along each axis, or itself.

    Args:
        points: shape [n, d].
        distance: in the points' unit; no two points that stand for others are that close.

    Returns:
        Shape [n].
    """
    first_of: dict[tuple[float, ...], int] = {}  # by cell, which has room for one
    firsts = np.arange(len(points))
    positions = points.tolist()
    for number, cell in enumerate(np.floor(points / distance).tolist()):
        near = map(first_of.get, product(*((at - 1.0, at, at + 1.0) for at in cell)))
        close = (n for n in near if n is not None and _is_within(positions[n], positions[number], distance))
        firsts[number] = min(close, default=number)
        if firsts[number] == number:
            first_of[tuple(cell)] = number
    return firsts


def _is_within(first: list[float], second: list[float], distance: float) -> bool:
    return all(abs(a - b) <= distance for a, b in zip(first, second, strict=True))


def _single(triangles: IndexArray) -> IndexArray:
    """Return the triangles that name three vertices, of equal ones that look to the same side the first."""
    a, b, c = triangles.T
    whole = triangles[(a != b) & (b != c) & (c != a)]
    turned = np.take_along_axis(whole, (whole.argmin(axis=1)[:, None] + np.arange(3)) % 3, axis=1)
    _, first = np.unique(turned, axis=0, return_index=True)
    return np.asarray(whole[np.sort(first)])


def heights_mm(corners_mm: FloatArray) -> FloatArray:
    """Return the heights of triangles, with corners of shape [f, 3, 3], over their longest edges [mm], shape [f]."""
    edges = np.roll(corners_mm, -1, axis=1) - corners_mm
    longest = np.sqrt((edges**2).sum(axis=2)).max(axis=1)
    areas = np.sqrt((np.cross(edges[:, 0], edges[:, 1]) ** 2).sum(axis=1))
    return np.asarray(areas / np.maximum(longest, 1e-300))


def _divided_at_t_junctions(vertices_mm: FloatArray, triangles: IndexArray, height_mm: float) -> IndexArray:
    """Return the triangles with the longest edges of those without height flipped.

    Of the triangle b, a, m with m on the edge from a to b, and its neighbour a, b, c, become a, m, c and m, b, c. An
    edge is flipped only where this leaves fewer triangles without height, so there are at most as many flips as there
    are of these.
    """
    low = set(np.flatnonzero(heights_mm(vertices_mm[triangles]) <= height_mm).tolist())
    if not low:
        return triangles
    faces = [(a, b, c) for a, b, c in triangles.tolist()]
    points = vertices_mm.tolist()
    owner = {edge: number for number, face in enumerate(faces) for edge in _edges_of(face)}

    def is_low(face: tuple[int, int, int]) -> bool:
        a, b, c = (points[corner] for corner in face)
        (ux, uy, uz), (vx, vy, vz) = ([to - at for to, at in zip(end, a, strict=True)] for end in (b, c))
        n = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        longest = max(_squared_mm2(a, b), _squared_mm2(b, c), _squared_mm2(c, a))
        return bool(sum(along * along for along in n) <= height_mm * height_mm * longest)

    waiting = deque(sorted(low))
    while waiting:
        number = waiting.popleft()
        if number not in low:
            continue
        a, b = max(_edges_of(faces[number]), key=lambda edge: _squared_mm2(points[edge[0]], points[edge[1]]))
        neighbour = owner.get((b, a))
        if neighbour is None:
            continue
        m, c = (next(corner for corner in faces[n] if corner not in (a, b)) for n in (number, neighbour))
        flipped = {number: (b, m, c), neighbour: (m, a, c)}
        still_low = {n for n, face in flipped.items() if is_low(face)}
        if c == m or (m, c) in owner or (c, m) in owner or len(still_low) >= len(low & flipped.keys()):
            continue
        for edge in ((a, b), (b, a)):
            owner.pop(edge, None)
        for n, face in flipped.items():
            faces[n] = face
            owner.update(dict.fromkeys(_edges_of(face), n))
        low = low - flipped.keys() | still_low
        around = {owner.get((q, p)) for face in flipped.values() for p, q in _edges_of(face)}
        waiting.extend(sorted(n for n in around if n in low))
    return np.array(faces, dtype=np.int64)


def _squared_mm2(first: list[float], second: list[float]) -> float:
    return sum((b - a) * (b - a) for a, b in zip(first, second, strict=True))


def _edges_of(face: tuple[int, int, int]) -> Iterator[tuple[int, int]]:
    a, b, c = face
    return iter(((a, b), (b, c), (c, a)))


def placed_on_base(surface: DrawnSurface, *, length_mm: float, width_mm: float) -> DrawnSurface:
    """Return the surface moved, and stretched by the tolerance of its base, so that its box has this length and width.

    Args:
        surface: in any place, its longer side along x, sensing face upwards.
        length_mm: extent along x.
        width_mm: extent along y.
    """
    low, extent = surface.vertices_mm.min(axis=0), surface.extent_mm
    stretch = np.array([length_mm / extent[0], width_mm / extent[1], 1.0])
    to = np.array([0.5 * length_mm, 0.5 * width_mm, 0.0])
    return DrawnSurface(vertices_mm=(surface.vertices_mm - low) * stretch - to, triangles=surface.triangles)


_SPACING_MM = 0.5


_MAX_CUTS = 64


# Where a surface would get more points, they lie further apart; its corners are always among them.
MAX_SAMPLES = 200_000


def samples_mm(corners: FloatArray) -> FloatArray:
    """Return points of all triangles, corners included, about 0.5 mm apart, shape [n, 3] [mm].

    Args:
        corners: of the triangles [mm], shape [f, 3, 3].
    """
    return samples_of_triangles_mm(corners)[0]


def samples_of_triangles_mm(corners: FloatArray) -> tuple[FloatArray, IndexArray]:
    """Return the points of `samples_mm` and the number of the triangle that each is of, shape [n]."""
    turned = _longest_side_first(corners)
    along_mm, across_mm = _extents_mm(turned)
    spacing_mm = _SPACING_MM
    cuts = _cuts(along_mm, across_mm, spacing_mm)
    while _most_samples(cuts) > MAX_SAMPLES and cuts.max() > 1:
        spacing_mm *= 2.0
        cuts = _cuts(along_mm, across_mm, spacing_mm)
    patterns, pattern = np.unique(cuts, axis=0, return_inverse=True)
    order, ends = np.argsort(pattern, kind="stable"), np.cumsum(np.bincount(pattern))
    points, numbers = [], []
    for (along, across), held in zip(patterns.tolist(), np.split(order, ends[:-1]), strict=True):
        weights = _weights(along, across)
        points.append(_combined(turned[held], weights).reshape(-1, 3))
        numbers.append(np.repeat(held, len(weights)))
    return np.concatenate(points), np.concatenate(numbers)


def pulled_corners(corners: FloatArray, distance: float) -> FloatArray:
    """Return points inside triangles, each this far from a corner on the way to the middle, or there.

    Args:
        corners: in the plane or in space, shape [f, 3, d].
        distance: in the corners' unit.

    Returns:
        Shape [f, 3, d].
    """
    middle = (corners[:, 0] + corners[:, 1] + corners[:, 2])[:, None, :] / 3.0
    way = middle - corners
    length = np.sqrt((way * way).sum(axis=2, keepdims=True))
    return np.asarray(corners + way * np.minimum(1.0, distance / np.maximum(length, 1e-300)))


def _longest_side_first(corners: FloatArray) -> FloatArray:
    """Return the triangles' corners turned so that the first two are the ends of the longest side."""
    sides = corners - corners[:, [1, 2, 0]]
    first = (sides * sides).sum(axis=2).argmax(axis=1)
    return np.asarray(corners[np.arange(len(corners))[:, None], (first[:, None] + np.arange(3)) % 3])


def _extents_mm(turned: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the length of the first side and the distance of the third corner from it [mm], each of shape [f]."""
    side, other = turned[:, 1] - turned[:, 0], turned[:, 2] - turned[:, 0]
    normal = np.cross(side, other)
    length = np.sqrt((side * side).sum(axis=1))
    return length, np.sqrt((normal * normal).sum(axis=1)) / np.maximum(length, 1e-300)


def _cuts(along_mm: FloatArray, across_mm: FloatArray, spacing_mm: float) -> IndexArray:
    """Return in how many pieces triangles are cut along their longest side and across it, shape [f, 2]."""
    pieces = np.ceil(np.column_stack([along_mm, across_mm]) / spacing_mm)
    return np.asarray(np.clip(pieces, 1, _MAX_CUTS).astype(np.int64))


def _most_samples(cuts: IndexArray) -> int:
    return int(((cuts[:, 0] + 2) * (cuts[:, 1] + 1)).sum())


def _weights(along: int, across: int) -> FloatArray:
    """Return weights of the corners at points in rows parallel to the first side, shape [w, 3]."""
    rows = []
    for row in range(across + 1):
        third = row / across
        pieces = int(np.ceil(along * (1.0 - third)))
        second = (1.0 - third) * np.arange(pieces + 1) / max(pieces, 1)
        rows.append(np.column_stack([1.0 - third - second, second, np.full(pieces + 1, third)]))
    return np.concatenate(rows)


def _combined(corners: FloatArray, weights: FloatArray) -> FloatArray:
    """Return weighted sums of the corners of every triangle, shape [f, w, 3]."""
    return np.asarray(sum(weights[None, :, k, None] * corners[:, None, k, :] for k in range(3)))
