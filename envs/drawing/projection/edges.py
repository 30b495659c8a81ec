"""Edges of surfaces as lines of a picture: which edges are drawn, and which parts of them are seen."""

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from .camera import ParallelCamera
from .visibility import Visible

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]

# Faces that meet at less than this have no edge between them.
_SMOOTH_DEG = 12.0
_SAMPLE_DISTANCE_PX = 2.0
# An edge lies on the surface that it bounds; only what is nearer than this hides it.
_SLACK_M = 4e-4


def sharp_edges(vertices_m: FloatArray, triangles: IndexArray) -> IndexArray:
    """Return the edges at which a closed surface has a fold, vertex indices, shape [e, 2]."""
    normals = unit_normals(vertices_m, triangles)
    first: dict[tuple[int, int], int] = {}
    sharp = []
    for number, triangle in enumerate(triangles.tolist()):
        for i in range(3):
            a, b = sorted((triangle[i], triangle[(i + 1) % 3]))
            other = first.setdefault((a, b), number)
            if other != number and normals[number] @ normals[other] < np.cos(np.radians(_SMOOTH_DEG)):
                sharp.append((a, b))
    return np.array(sharp, dtype=np.int64).reshape(-1, 2)


def unique_edges(triangles: IndexArray) -> IndexArray:
    """Return all edges of a closed surface, each once, shape [e, 2]."""
    directed = np.concatenate([triangles[:, [i, (i + 1) % 3]] for i in range(3)])
    return np.asarray(directed[directed[:, 0] < directed[:, 1]])


def unit_normals(vertices_m: FloatArray, triangles: IndexArray) -> FloatArray:
    """Return the outward unit normals of triangles, shape [t, 3]."""
    corners = vertices_m[triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return np.asarray(normals / np.linalg.norm(normals, axis=1, keepdims=True))


def visible_lines(
    ends_m: FloatArray, camera: ParallelCamera, visible: Visible, *, kept_m: FloatArray | None = None
) -> list[FloatArray]:
    """Return the visible parts of straight lines, as polylines in picture coordinates [pixel], each [k, 2].

    Args:
        ends_m: both ends of every line in the world [m], shape [l, 2, 3].
        camera: the picture's.
        visible: everything that may hide them.
        kept_m: a line is only there where this value, linear along it, is not negative; values at the ends,
            shape [l, 2].
    """
    ends = camera.project(ends_m)
    lengths_px = np.abs(ends[:, 1, :2] - ends[:, 0, :2]).max(axis=1)
    samples = np.maximum(2, (lengths_px / _SAMPLE_DISTANCE_PX).astype(int) + 1)
    line = np.repeat(np.arange(len(ends)), samples)
    within = np.arange(len(line)) - (np.cumsum(samples) - samples)[line]
    part = (within / (samples[line] - 1))[:, None]
    points = (1.0 - part) * ends[line, 0] + part * ends[line, 1]
    seen = ~visible.hides(points, slack_m=_SLACK_M)
    if kept_m is not None:
        seen &= (1.0 - part[:, 0]) * kept_m[line, 0] + part[:, 0] * kept_m[line, 1] >= -1e-9
    return [points[run, :2] for run in _runs(seen, line)]


def _runs(seen: NDArray[np.bool_], line: IndexArray) -> list[slice]:
    """Return the stretches of at least two points of one line that are all seen."""
    changes = np.flatnonzero((seen[1:] != seen[:-1]) | (line[1:] != line[:-1])) + 1
    bounds = np.concatenate([[0], changes, [len(seen)]]).tolist()
    return [slice(start, stop) for start, stop in pairwise(bounds) if stop - start > 1 and seen[start]]
