"""Marker flow as a policy sees it: a random grid, carried by the sensing surface, projected, made noisy.

Every observation draws a new grid. All randomness comes from the generator that is passed in,
in this order per sensor, left sensor first:

1. interval, rotation, translation x, translation y: one uniform each;
2. for the n markers of the grid, x fastest: n uniforms for the shifts along x, then n along y;
3. for the m markers that are on the sensing surface and in the picture: m uniforms; below the probability is lost;
4. for the k that remain: uniforms of shape [2 k, 2], reference before current, whose `normal_pairs` move u and v;
5. only if k >= 128: a choice of 128 of k without replacement.
"""

from dataclasses import dataclass
from functools import cached_property, lru_cache
from math import ceil
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from vitac.errors import VitacError

from ..compilation import allocating_kernel, kernel
from ..deterministic_math import normal_pairs, sine_cosine
from ..fem.model.mesh import GelMesh
from .camera import CHALLENGE_CAMERA, CHALLENGE_MOUNT, CameraIntrinsics, CameraMount, project
from .gel import MARKER_COUNT

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]

# Half extent of the grid before translation and rotation.
_GRID_HALF_X_MM = 8.0
_GRID_HALF_Y_MM = 6.0
# A marker is seen where its reference is inside this part of the picture.
_U_RANGE_PX = (5.0, 320.0)
_V_RANGE_PX = (5.0, 240.0)
# Triangles nearest to a marker among which the one that carries it is looked for: the challenge's number, and one that
# is enough where cells are of different lengths.
_CANDIDATES, _CANDIDATES_AMONG_UNEVEN = 4, 12
# Number of meshes; every episode has new sensors, and the hull of a surface takes a millisecond.
_SURFACES_KEPT = 4


class NoMarkerVisible(VitacError):
    """Not one marker of the drawn grid can be seen; enlarge the sensing surface or lower the loss probability."""


@dataclass(frozen=True, kw_only=True)
class MarkerSettings:
    """Ranges of the random grid; the defaults are those of every 2025 configuration.

    Attributes:
        interval_mm: lowest and highest spacing.
        rotation_rad: largest rotation either way.
        translation_mm: largest translation either way along x and y.
        shift_mm: largest shift of a single marker either way along x and y.
        noise_px: standard deviation of the pixel noise.
        loss_probability: probability that a visible marker is not tracked.
        drift_u_px_s: speed at which the current positions leave the references along u, the same for all markers.
        drift_v_px_s: the same along v.
        delay: part of an env step by which what is observed lags behind, from 0 to 1.
    """

    interval_mm: tuple[float, float] = (1.95, 2.15)
    rotation_rad: float = 0.1
    translation_mm: float = 1.0
    shift_mm: float = 0.1
    noise_px: float = 0.5
    loss_probability: float = 0.01
    drift_u_px_s: float = 0.0
    drift_v_px_s: float = 0.0
    delay: float = 0.0


@dataclass(frozen=True, kw_only=True)
class MountedMarkerSettings(MarkerSettings):
    """The same, seen by cameras that are not mounted as the challenge's.

    Attributes:
        left: camera of the left sensor.
        right: camera of the right sensor.
    """

    left: CameraMount = CHALLENGE_MOUNT
    right: CameraMount = CHALLENGE_MOUNT


class SurfaceArrays(NamedTuple):
    """What kernels need of a sensing surface; see there."""

    vertices_m: FloatArray
    triangles: IndexArray
    centroids_m: FloatArray
    hull_m: FloatArray
    candidates: int


@dataclass(frozen=True, kw_only=True, eq=False)
class SensingSurface:
    """Undeformed sensing triangles seen along the camera's axis.

    Attributes:
        vertices_m: sensing nodes, camera x and y [m], shape [s, 2].
        triangles: indices into them, shape [t, 3].
        candidates: how many of them, nearest first, are looked at for a marker.
    """

    vertices_m: FloatArray
    triangles: IndexArray
    candidates: int = _CANDIDATES

    @classmethod
    @lru_cache(maxsize=_SURFACES_KEPT)
    def from_gel(cls, mesh: GelMesh) -> "SensingSurface":
        """Return the triangles of the mesh's boundary whose corners are all sensing nodes; made once for a mesh."""
        number = np.full(len(mesh.rest_position_m), -1, dtype=np.int64)
        number[mesh.sensing_nodes] = np.arange(len(mesh.sensing_nodes))
        on_surface = mesh.sensing[mesh.surface_triangles].all(axis=1)
        if not on_surface.any():
            raise NoMarkerVisible(f"{mesh.name}: no boundary triangle has three sensing nodes; mark a whole face.")
        # Camera x and y are the negated gel axes.
        vertices_m = -mesh.rest_position_m[mesh.sensing_nodes, :2]
        return cls(
            vertices_m=vertices_m,
            triangles=number[mesh.surface_triangles[on_surface]],
            candidates=_CANDIDATES_AMONG_UNEVEN if mesh.is_hexahedral else _CANDIDATES,
        )

    @cached_property
    def arrays(self) -> SurfaceArrays:
        """All arrays, for kernels."""
        return SurfaceArrays(self.vertices_m, self.triangles, self.centroids_m, self.hull_m, self.candidates)

    @cached_property
    def hull_m(self) -> FloatArray:
        """Corners of the convex hull, counter-clockwise, shape [h, 2] [m]."""
        return convex_hull(self.vertices_m)

    @cached_property
    def node_shares(self) -> FloatArray:
        """Part of the face's area that each sensing node stands for, shape [s]: a third of each triangle around it."""
        a, b, c = (self.vertices_m[self.triangles[:, corner]] for corner in range(3))
        areas, shares = np.abs(_doubled_area(b - a, c - a)), np.zeros(len(self.vertices_m))
        np.add.at(shares, self.triangles, areas[:, None])
        return np.asarray(shares / shares.sum())

    @cached_property
    def centroids_m(self) -> FloatArray:
        """Centroids of the triangles [m], shape [t, 2]."""
        corners = self.vertices_m[self.triangles]
        return (corners[:, 0] + corners[:, 1] + corners[:, 2]) / 3.0


@lru_cache(maxsize=_SURFACES_KEPT)
def attach_nodes(fine: GelMesh, coarse: GelMesh) -> tuple[IndexArray, FloatArray]:
    """Return where the sensing nodes of a gel are on the flat sensing face of a coarser one.

    That is three of the coarser gel's sensing nodes for each, and its barycentric weights; both of shape [s, 3].
    """
    face, points_m = SensingSurface.from_gel(coarse), SensingSurface.from_gel(fine).vertices_m[:, None]
    a, b, c = (face.vertices_m[face.triangles[:, corner]] for corner in range(3))
    area = _doubled_area(b - a, c - a)
    second, third = _doubled_area(points_m - a, c - a) / area, _doubled_area(b - a, points_m - a) / area
    weights = np.stack([1.0 - second - third, second, third], axis=2)
    chosen = weights.min(axis=2).argmax(axis=1)
    return face.triangles[chosen], weights[np.arange(len(chosen)), chosen]


def _doubled_area(first: FloatArray, second: FloatArray) -> FloatArray:
    return np.asarray(first[..., 0] * second[..., 1] - first[..., 1] * second[..., 0])


def draw_markers(
    surface: SensingSurface,
    reference_m: FloatArray,
    current_m: FloatArray,
    settings: MarkerSettings,
    random: np.random.Generator,
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Return the markers of a new grid that are seen, shape [2, m, 2] [pixel], and which of them are not lost, [m].

    Args:
        surface: sensing surface of the gel.
        reference_m: sensing nodes after the grasp, camera frame [m], shape [s, 3].
        current_m: sensing nodes now, camera frame [m], shape [s, 3].
        settings: ranges of the grid.
        random: the episode's generator; see the module for the order of the draws.
    """
    grid = _draw_grid(settings, random)
    shifts = random.random(2 * grid.columns * grid.rows)
    flow = _seen(grid, shifts, surface.arrays, reference_m, current_m, CHALLENGE_CAMERA)
    return flow, random.random(flow.shape[1]) >= settings.loss_probability


def tracked(
    flow: FloatArray, kept: NDArray[np.bool_], settings: MarkerSettings, random: np.random.Generator
) -> FloatArray:
    """Return exactly 128 markers with noise, shape [2, 128, 2] [pixel].

    Args:
        flow: reference and current pixel positions of all that are seen, shape [2, m, 2].
        kept: which of them are not lost, shape [m].
        settings: amount of noise.
        random: the episode's generator.

    Raises:
        NoMarkerVisible: all are lost, or none was seen.
    """
    count = np.count_nonzero(kept)
    if count == 0:
        raise NoMarkerVisible("No marker of the grid lies on the sensing surface and in the picture.")
    noisy = _noisy(flow, kept, random.random((2 * count, 2)), settings.noise_px)
    if count < MARKER_COUNT:
        return noisy
    return noisy[:, random.choice(count, MARKER_COUNT, replace=False)]


class _Grid(NamedTuple):
    """A drawn grid of markers, before the shifts of the single ones; lengths [mm].

    Attributes:
        interval: between two columns or rows.
        angle_rad: by which it is turned.
        x: by which it is moved along x.
        y: by which it is moved along y.
        first_column: number of the leftmost column; the one through the middle has 0.
        columns: how many there are.
        first_row: number of the lowest row.
        rows: how many there are.
        shift: largest shift of a single marker.
    """

    interval: float
    angle_rad: float
    x: float
    y: float
    first_column: int
    columns: int
    first_row: int
    rows: int
    shift: float


def _draw_grid(settings: MarkerSettings, random: np.random.Generator) -> _Grid:
    """Draw what all markers have in common."""
    draws = random.random(4).tolist()
    moved = settings.translation_mm
    interval = _uniform(*settings.interval_mm, draws[0])
    angle_rad = _uniform(-settings.rotation_rad, settings.rotation_rad, draws[1])
    x, y = (_uniform(-moved, moved, draw) for draw in draws[2:])
    columns, rows = _line(_GRID_HALF_X_MM, interval, x), _line(_GRID_HALF_Y_MM, interval, y)
    return _Grid(interval, angle_rad, x, y, *columns, *rows, settings.shift_mm)


def _uniform(low: float, high: float, draw: float) -> float:
    """Return a draw from [0, 1) as one from [low, high), to the bits of NumPy's `Generator.uniform`."""
    return low + (high - low) * draw


def _line(half: float, interval: float, translation: float) -> tuple[int, int]:
    """Return the number of the first marker on a line across the gel, and how many there are."""
    first = -ceil((half + translation) / interval)
    return first, ceil((half - translation) / interval) - first + 1


@allocating_kernel
def find_in_picture(pixels: FloatArray) -> NDArray[np.bool_]:
    """Return which pixel positions, shape [n, 2], are where markers are tracked."""
    inside = np.empty(pixels.shape[0], dtype=np.bool_)
    for i in range(pixels.shape[0]):
        u, v = pixels[i, 0], pixels[i, 1]
        inside[i] = _U_RANGE_PX[0] < u < _U_RANGE_PX[1] and _V_RANGE_PX[0] < v < _V_RANGE_PX[1]
    return inside


def convex_hull(points: FloatArray) -> FloatArray:
    """Return the corners of the convex hull of points in the plane, counter-clockwise (Andrew 1979), none collinear."""
    ordered = points[np.lexsort((points[:, 1], points[:, 0]))]
    return np.array(_half_hull(ordered)[:-1] + _half_hull(ordered[::-1])[:-1])


def _half_hull(ordered: FloatArray) -> list[FloatArray]:
    chain: list[FloatArray] = []
    for point in ordered:
        while len(chain) > 1 and not _turns_left(chain[-2], chain[-1], point):
            chain.pop()
        chain.append(point)
    return chain


def _turns_left(a: FloatArray, b: FloatArray, c: FloatArray) -> bool:
    return bool((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]) > 0.0)


@allocating_kernel
def _seen(
    grid: _Grid,
    shifts: FloatArray,
    surface: SurfaceArrays,
    reference_m: FloatArray,
    current_m: FloatArray,
    camera: CameraIntrinsics,
) -> FloatArray:
    """Return where the markers are seen whose reference is in the picture, before and now, shape [2, m, 2] [pixel].

    One kernel for all: between two IPC steps little of NumPy's code is in the caches.
    """
    triangle, weights = _attach(_points_m(grid, shifts), surface)
    corners = surface.triangles[triangle]
    reference = project(interpolated(reference_m, corners, weights), camera)
    current = project(interpolated(current_m, corners, weights), camera)
    seen = np.flatnonzero(find_in_picture(reference))
    flow = np.empty((2, len(seen), 2))
    for i in range(len(seen)):
        flow[0, i], flow[1, i] = reference[seen[i]], current[seen[i]]
    return flow


@allocating_kernel
def _points_m(grid: _Grid, shifts: FloatArray) -> FloatArray:
    """Return the markers in the plane of the gel, x fastest, camera x and y [m], shape [n, 2].

    Args:
        grid: its lines.
        shifts: drawn from [0, 1) for every marker along x, then along y, shape [2 n].
    """
    sine, cosine = sine_cosine(grid.angle_rad)
    count = grid.columns * grid.rows
    points = np.empty((count, 2))
    for i in range(count):
        x = (grid.first_column + i % grid.columns) * grid.interval + grid.x
        y = (grid.first_row + i // grid.columns) * grid.interval + grid.y
        x += -grid.shift + (grid.shift + grid.shift) * shifts[i]
        y += -grid.shift + (grid.shift + grid.shift) * shifts[count + i]
        points[i, 0] = (cosine * x - sine * y) * 1e-3
        points[i, 1] = (sine * x + cosine * y) * 1e-3
    return points


@allocating_kernel
def _noisy(flow: FloatArray, kept: NDArray[np.bool_], uniform: FloatArray, noise_px: float) -> FloatArray:
    """Return the kept markers with noise; of fewer than 128 the last one is repeated up to this number.

    Args:
        flow: reference and current, shape [2, m, 2] [pixel].
        kept: which of them, k in all, shape [m].
        uniform: drawn from [0, 1), of all references first, shape [2 k, 2].
        noise_px: standard deviation [pixel].
    """
    normal = normal_pairs(uniform)
    count = normal.shape[0] // 2
    out = np.empty((2, max(count, MARKER_COUNT), 2))
    for side in range(2):
        k = 0
        for i in range(flow.shape[1]):
            if kept[i]:
                for axis in range(2):
                    out[side, k, axis] = flow[side, i, axis] + noise_px * normal[side * count + k, axis]
                k += 1
        for i in range(count, out.shape[1]):
            out[side, i] = out[side, count - 1]
    return out


@allocating_kernel
def _attach(grid: FloatArray, surface: SurfaceArrays) -> tuple[IndexArray, FloatArray]:
    """Return triangle and barycentric weights, shapes [m] and [m, 3], of the grid points inside the hull, in order.

    Of the candidates, which are the triangles nearest by centroid, the first that contains the point; if none does, the
    nearest, whose weights then extrapolate.
    """
    vertices, triangles = surface.vertices_m, surface.triangles
    chosen = np.empty(grid.shape[0], dtype=np.int64)
    weights = np.empty((grid.shape[0], 3))
    count = 0
    for i in range(grid.shape[0]):
        x, y = grid[i, 0], grid[i, 1]
        if not _is_in_hull(x, y, surface.hull_m):
            continue
        near = _nearest(x, y, surface.centroids_m, surface.candidates)
        chosen[count] = near[0]
        for k in range(near.shape[0]):
            w0, w1, w2 = _barycentric(x, y, vertices, triangles[near[k]])
            if w0 >= 0.0 and w1 >= 0.0 and w2 >= 0.0:
                chosen[count] = near[k]
                break
        w0, w1, w2 = _barycentric(x, y, vertices, triangles[chosen[count]])
        weights[count, 0], weights[count, 1], weights[count, 2] = w0, w1, w2
        count += 1
    return chosen[:count], weights[:count]


@kernel
def _is_in_hull(x: float, y: float, hull: FloatArray) -> bool:
    for i in range(hull.shape[0]):
        ax, ay = hull[i - 1, 0], hull[i - 1, 1]
        bx, by = hull[i, 0], hull[i, 1]
        if (bx - ax) * (y - ay) - (by - ay) * (x - ax) < 0.0:
            return False
    return True


@allocating_kernel
def _nearest(x: float, y: float, centroids: FloatArray, most: int) -> IndexArray:
    """Return the indices of at most this number of nearest centroids, nearest first; lower index first among equals."""
    count = min(most, centroids.shape[0])
    best = np.empty(count, dtype=np.int64)
    distance = np.full(count, np.inf)
    for i in range(centroids.shape[0]):
        dx, dy = centroids[i, 0] - x, centroids[i, 1] - y
        squared = dx * dx + dy * dy
        if squared < distance[count - 1]:
            k = count - 1
            while k > 0 and distance[k - 1] > squared:
                distance[k], best[k] = distance[k - 1], best[k - 1]
                k -= 1
            distance[k], best[k] = squared, i
    return best


@kernel
def _barycentric(x: float, y: float, vertices: FloatArray, triangle: IndexArray) -> tuple[float, float, float]:
    """Return the weights (1 - w1 - w2, w1, w2) with p = p0 + w1 (p1 - p0) + w2 (p2 - p0)."""
    ax, ay = vertices[triangle[0], 0], vertices[triangle[0], 1]
    bx, by = vertices[triangle[1], 0] - ax, vertices[triangle[1], 1] - ay
    cx, cy = vertices[triangle[2], 0] - ax, vertices[triangle[2], 1] - ay
    determinant = bx * cy - by * cx
    w1 = ((x - ax) * cy - (y - ay) * cx) / determinant
    w2 = (bx * (y - ay) - by * (x - ax)) / determinant
    return 1.0 - w1 - w2, w1, w2


@allocating_kernel
def interpolated(points: FloatArray, corners: IndexArray, weights: FloatArray) -> FloatArray:
    """Return the weighted sums of the corners' positions, shape [m, 3]."""
    out = np.empty((corners.shape[0], 3))
    for i in range(corners.shape[0]):
        for k in range(3):
            out[i, k] = (
                weights[i, 0] * points[corners[i, 0], k]
                + weights[i, 1] * points[corners[i, 1], k]
                + weights[i, 2] * points[corners[i, 2], k]
            )
    return out
