"""Closed triangle surfaces built from flat faces. Used by pegs, holes, keys and locks."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..fem.model.mesh import SurfaceMesh
from .polygon import Polygon
from .triangulation import triangulate

MILLIMETRE_M = 1e-3
# Coordinate axes in the plane of a prism's profile, and the direction in which it is extruded; each is right-handed.
XY_ALONG_Z = (0, 1, 2)
ZX_ALONG_Y = (2, 0, 1)


@dataclass(frozen=True, kw_only=True)
class Face:
    """Flat face of a solid.

    Attributes:
        outline_mm: corners counter-clockwise seen from outside the solid [mm], shape [n, 3].
        holes_mm: outlines of openings in the face [mm].
    """

    outline_mm: NDArray[np.float64]
    holes_mm: tuple[NDArray[np.float64], ...] = ()


def solid_from_faces(faces: Iterable[Face], name: str) -> SurfaceMesh:
    """Return the surface of the solid that the faces enclose; corners at the same position become one vertex [m]."""
    vertices: dict[tuple[float, ...], int] = {}
    triangles = []
    for face in faces:
        corners = np.concatenate([face.outline_mm, *face.holes_mm])
        numbers = [vertices.setdefault(tuple(corner.tolist()), len(vertices)) for corner in corners]
        triangles += [[numbers[i] for i in triangle] for triangle in _triangulated(face)]
    positions_m = np.array(list(vertices), dtype=np.float64) * MILLIMETRE_M
    return SurfaceMesh(vertices_m=positions_m, triangles=np.array(triangles, dtype=np.int64), name=name)


def prism_faces(
    profile_mm: Polygon,
    low_mm: float,
    high_mm: float,
    *,
    axes: tuple[int, int, int] = XY_ALONG_Z,
    holes_mm: tuple[Polygon, ...] = (),
) -> list[Face]:
    """Return the faces of a prism: two end caps, and one wall for every edge of the profile and of its through holes.

    Args:
        profile_mm: counter-clockwise outline [mm], shape [n, 2], in the plane of `axes[0]`, `axes[1]`.
        low_mm: start of the extrusion along `axes[2]` [mm].
        high_mm: end of the extrusion [mm].
        axes: a cyclic permutation of (0, 1, 2).
        holes_mm: counter-clockwise outlines of through holes [mm].
    """

    def placed(polygon: Polygon, height: float) -> NDArray[np.float64]:
        corners = np.empty((len(polygon), 3))
        corners[:, axes[0]], corners[:, axes[1]], corners[:, axes[2]] = polygon[:, 0], polygon[:, 1], height
        return corners

    def walls(polygon: Polygon) -> list[Face]:
        low, high = placed(polygon, low_mm), placed(polygon, high_mm)
        return [Face(outline_mm=np.array([low[i - 1], low[i], high[i], high[i - 1]])) for i in range(len(polygon))]

    bottom = Face(
        outline_mm=placed(profile_mm[::-1], low_mm), holes_mm=tuple(placed(hole, low_mm) for hole in holes_mm)
    )
    top = Face(outline_mm=placed(profile_mm, high_mm), holes_mm=tuple(placed(hole, high_mm) for hole in holes_mm))
    hole_walls = [wall for hole in holes_mm for wall in walls(hole[::-1])]
    return [bottom, top, *walls(profile_mm), *hole_walls]


def rectangle(x_low: float, x_high: float, y_low: float, y_high: float) -> Polygon:
    """Return the counter-clockwise rectangle, shape [4, 2]."""
    return np.array([[x_low, y_low], [x_high, y_low], [x_high, y_high], [x_low, y_high]], dtype=np.float64)


def nearest_vertices(surface: SurfaceMesh, points_m: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return the vertex of a surface nearest to each of the points [m], shape [n, 3] to [n]."""
    apart = surface.vertices_m[None, :, :] - points_m[:, None, :]
    return np.asarray((apart * apart).sum(axis=2).argmin(axis=1), dtype=np.int64)


def _triangulated(face: Face) -> list[tuple[int, int, int]]:
    """Return the triangles of a face, found in its projection along the largest component of its normal."""
    normal = _area_vector(face.outline_mm)
    along = int(np.abs(normal).argmax())
    first, second = (along + 1) % 3, (along + 2) % 3
    plane = [first, second] if normal[along] > 0 else [second, first]
    return triangulate(face.outline_mm[:, plane], tuple(hole[:, plane] for hole in face.holes_mm))


def _area_vector(outline: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(np.cross(outline, np.roll(outline, -1, axis=0)).sum(axis=0))
