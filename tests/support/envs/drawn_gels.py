"""Gels as a participant would draw them, in millimetres, and the bytes of their STL files."""

import struct
from collections.abc import Callable, Sequence
from math import cos, pi, sin

import numpy as np
from numpy.typing import NDArray
from vitac.envs.geometry.solid import Face, as_polygon, prism_faces, rectangle, solid_from_faces
from vitac.envs.sensor_design.surface import DrawnSurface

FloatArray = NDArray[np.float64]
Outline = list[tuple[float, float]]

LENGTH_MM, WIDTH_MM = 25.25, 20.75
_BASE = rectangle(-0.5 * LENGTH_MM, 0.5 * LENGTH_MM, -0.5 * WIDTH_MM, 0.5 * WIDTH_MM)


def flat(thickness_mm: float = 4.0) -> DrawnSurface:
    """A plain box."""
    return _drawn(prism_faces(_BASE, 0.0, thickness_mm))


def bevelled(inset_mm: float = 1.0) -> DrawnSurface:
    """A box of 3 mm with a bevel of 1 mm: the challenge's sample for an inset of 1 mm."""
    half_x, half_y = 0.5 * LENGTH_MM - inset_mm, 0.5 * WIDTH_MM - inset_mm
    top = rectangle(-half_x, half_x, -half_y, half_y)
    return _drawn([*prism_faces(_BASE, 0.0, 3.0)[:1], *_walls(_BASE, 0.0, 3.0), *_frustum(_BASE, 3.0, top, 4.0)])


def pillars(outlines: Sequence[Outline], *, floor_mm: float = 3.0, top_mm: float = 4.0) -> DrawnSurface:
    """Prisms with vertical walls on a floor."""
    polygons = [as_polygon(outline) for outline in outlines]
    faces = _box_with_openings(floor_mm, polygons)
    for polygon in polygons:
        faces += [*_walls(polygon, floor_mm, top_mm), Face(outline_mm=_at(polygon, top_mm))]
    return _drawn(faces)


def ridge() -> DrawnSurface:
    """A bar of 2 mm with vertical walls along y, 1.5 mm high."""
    return pillars([[(-1, -7), (1, -7), (1, 7), (-1, 7)]], floor_mm=2.5, top_mm=4.0)


def pit() -> DrawnSurface:
    """A box with a pit of 1 mm."""
    return pillars([[(-4, -4), (4, -4), (4, 4), (-4, 4)]], floor_mm=4.0, top_mm=3.0)


def pyramids(*, half_mm: float = 2.5, height_mm: float = 2.0) -> DrawnSurface:
    """Four square pyramids on a floor."""
    centres = [(x, y) for x in (-5.0, 5.0) for y in (-4.0, 4.0)]
    squares = [rectangle(x - half_mm, x + half_mm, y - half_mm, y + half_mm) for x, y in centres]
    faces = _box_with_openings(2.5, squares)
    for (x, y), square in zip(centres, squares, strict=True):
        tip = np.array([x, y, 2.5 + height_mm])
        faces += [Face(outline_mm=np.array([*_at(square[[i - 1, i]], 2.5), tip])) for i in range(4)]
    return _drawn(faces)


def gable() -> DrawnSurface:
    """A roof across the whole gel, whose foot and top meet the rim of the base."""
    bends = [(-12.625, 2.0), (-0.7, 2.0), (1.5, 4.0), (3.7, 2.0), (12.625, 2.0)]
    rim = [(12.625, 0.0), *reversed(bends), (-12.625, 0.0)]
    front, back = (np.array([(x, y, z) for x, z in rim]) for y in (-10.375, 10.375))
    sides = [Face(outline_mm=np.array([front[i], front[i - 1], back[i - 1], back[i]])) for i in range(len(rim))]
    return _drawn([Face(outline_mm=front), Face(outline_mm=back[::-1]), *sides])


def wedge() -> DrawnSurface:
    """A ramp that rises from the floor between two vertical walls, which fade to nothing at its foot."""
    a, b, c, d = (np.array([x, y]) for x, y in ((-5.0, -4.0), (5.0, -4.0), (5.0, 4.0), (-5.0, 4.0)))
    high, low = 4.0, 3.0
    faces = _box_with_openings(low, [np.array([a, b, c, d])])
    faces.append(Face(outline_mm=np.array([[*a, low], [*b, high], [*c, high], [*d, low]])))
    faces.append(Face(outline_mm=np.array([[*a, low], [*b, low], [*b, high]])))
    faces.append(Face(outline_mm=np.array([[*b, low], [*c, low], [*c, high], [*b, high]])))
    faces.append(Face(outline_mm=np.array([[*c, low], [*d, low], [*c, high]])))
    return _drawn(faces)


def dome(height_mm: float = 1.0, *, rim_mm: float = 3.0, cells: int = 40) -> DrawnSurface:
    """A top that falls smoothly from its centre to the rim."""
    return smooth(
        lambda x, y: rim_mm + height_mm * (1 - (2 * x / LENGTH_MM) ** 2) * (1 - (2 * y / WIDTH_MM) ** 2), cells
    )


def smooth(height_mm: Callable[[float, float], float], cells: int, rows: int | None = None) -> DrawnSurface:
    """A box whose top is cut into 2 x cells x rows triangles, cells x cells by default."""
    rows = cells if rows is None else rows
    xs, ys = np.linspace(-0.5, 0.5, cells + 1) * LENGTH_MM, np.linspace(-0.5, 0.5, rows + 1) * WIDTH_MM
    top = np.array([[(x, y, height_mm(x, y)) for y in ys] for x in xs])
    low = top * [1.0, 1.0, 0.0]
    corners = [*_grid(top), *_grid(low[::-1])]
    for upper, lower in (
        (top[:, 0], low[:, 0]),
        (top[-1], low[-1]),
        (top[::-1, -1], low[::-1, -1]),
        (top[0][::-1], low[0][::-1]),
    ):
        for i in range(len(upper) - 1):
            corners += [(lower[i], lower[i + 1], upper[i + 1]), (lower[i], upper[i + 1], upper[i])]
    return DrawnSurface.from_corners(np.array(corners))


def round_outline(x: float, y: float, radius: float, corners: int) -> Outline:
    """A regular polygon, counter-clockwise."""
    angles = [2 * pi * i / corners for i in range(corners)]
    return [(x + radius * cos(angle), y + radius * sin(angle)) for angle in angles]


def moved(surface: DrawnSurface, *, scale: float = 1.0, by: tuple[float, float, float] = (0, 0, 0)) -> DrawnSurface:
    """The same elsewhere and in another unit."""
    return DrawnSurface(vertices_mm=surface.vertices_mm * scale + by, triangles=surface.triangles)


def stl_bytes(surface: DrawnSurface) -> bytes:
    """A binary STL file."""
    records = b"".join(
        struct.pack("<3f", 0, 0, 0) + triangle.astype("<f4").tobytes() + b"\0\0" for triangle in surface.corners_mm
    )
    return b"\0" * 80 + struct.pack("<I", len(surface.triangles)) + records


def _drawn(faces: list[Face]) -> DrawnSurface:
    solid = solid_from_faces(faces, "gel")
    return DrawnSurface(vertices_mm=solid.vertices_m * 1e3, triangles=solid.triangles)


def _at(polygon: FloatArray, height_mm: float) -> FloatArray:
    return np.column_stack([polygon, np.full(len(polygon), height_mm)])


def _walls(polygon: FloatArray, low_mm: float, high_mm: float) -> list[Face]:
    return _frustum(polygon, low_mm, polygon, high_mm)[:-1]


def _frustum(polygon: FloatArray, low_mm: float, top: FloatArray, high_mm: float) -> list[Face]:
    """Sides and top between two outlines."""
    low, high = _at(polygon, low_mm), _at(top, high_mm)
    sides = [Face(outline_mm=np.array([low[i - 1], low[i], high[i], high[i - 1]])) for i in range(len(polygon))]
    return [*sides, Face(outline_mm=high)]


def _box_with_openings(height_mm: float, openings: Sequence[FloatArray]) -> list[Face]:
    top = Face(outline_mm=_at(_BASE, height_mm), holes_mm=tuple(_at(opening, height_mm) for opening in openings))
    return [Face(outline_mm=_at(_BASE[::-1], 0.0)), *_walls(_BASE, 0.0, height_mm), top]


def _grid(points: FloatArray) -> list[tuple[FloatArray, FloatArray, FloatArray]]:
    """Two triangles for each cell of a grid of shape [m, n, 3], counter-clockwise for rising x and y."""
    cells = [(i, j) for i in range(len(points) - 1) for j in range(points.shape[1] - 1)]
    halves = []
    for i, j in cells:
        a, b, c, d = points[i, j], points[i + 1, j], points[i + 1, j + 1], points[i, j + 1]
        halves += [(a, b, c), (a, c, d)]
    return halves


def together(*surfaces: DrawnSurface) -> DrawnSurface:
    """Several surfaces as one."""
    first = [0, *np.cumsum([len(surface.vertices_mm) for surface in surfaces])]
    return DrawnSurface(
        vertices_mm=np.concatenate([surface.vertices_mm for surface in surfaces]),
        triangles=np.concatenate([surface.triangles + n for surface, n in zip(surfaces, first, strict=False)]),
    )


def turned_inside_out(surface: DrawnSurface) -> DrawnSurface:
    """The same with all triangles clockwise."""
    return DrawnSurface(vertices_mm=surface.vertices_mm, triangles=surface.triangles[:, ::-1])


def stretched(surface: DrawnSurface, factors: tuple[float, float, float]) -> DrawnSurface:
    """The same, longer along each axis by its own factor."""
    return DrawnSurface(vertices_mm=surface.vertices_mm * factors, triangles=surface.triangles)


def leaning(overhang_mm: float) -> DrawnSurface:
    """A box whose walls lean outwards."""
    half_x, half_y = 0.5 * LENGTH_MM + overhang_mm, 0.5 * WIDTH_MM + overhang_mm
    top = rectangle(-half_x, half_x, -half_y, half_y)
    return _drawn([Face(outline_mm=_at(_BASE[::-1], 0.0)), *_frustum(_BASE, 0.0, top, 4.0)])
