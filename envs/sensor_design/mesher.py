"""Deterministic mesher for gels that are height fields over their base: the same bytes on every machine.

The faces' outlines are projected onto the base and triangulated there (`plane_mesh`), points are added where the
heights deviate, and the columns over the triangles are filled with tetrahedra (`columns`). Walls and creases keep their
place.
"""

from copy import deepcopy
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from vitac.errors import VitacError

from .columns import Columns
from .crossings import farthest
from .height_field import HeightField, MeshLine, add_outlines, convert_to_mm, heights_of_faces_mm, snap_to_grid
from .plane_mesh import GRID_PER_MM, PlaneMesh, TooManyPoints
from .surface import DrawnSurface, pulled_corners, samples_of_triangles_mm
from .tetrahedra import Tetrahedra, refined_tips

FloatArray = NDArray[np.float64]
PlanePoint = tuple[float, float]

# Longest edges that are tried in the plane, coarsest first.
_LONGEST_MM = (4.0, 3.6, 3.2, 2.8, 2.4, 2.0, 1.6)
# Cosines of the smallest angle at which a crease is kept.
_CREASE_COSINES = (0.98, 0.7)
# Cells through the thickness are about this high.
_LAYER_MM = 4.0
# No segment is halved below twice this for the sake of a triangle's shape.
_SHORTEST_MM = 0.25
# Heights are looked up this far inside a triangle, off the walls around it.
_INSIDE_MM = 0.1
# A point is added where the surfaces are further apart; points that are added at once are apart themselves.
_ERROR_MM = 0.08
_APART_MM = 1.0
_ROUNDS = 16


class FeatureBelowResolution(VitacError):
    """A gel has features too small for the nodes that are allowed; enlarge or remove them."""


@dataclass(frozen=True, kw_only=True)
class MeshGoal:
    """What a mesh has to be.

    Attributes:
        length_mm: extent of the base along x.
        width_mm: extent of the base along y.
        min_nodes: fewer are refined further.
        max_nodes: more are refused.
        max_distance_mm: largest distance between the surface of the mesh and the drawn one.
        max_volume_error: largest relative difference between the volumes.
        min_quality: smallest 6 sqrt(2) V / (longest edge)^3 of a tetrahedron.
        tip_depth_mm: what is at most so far below the highest point is a tip.
        min_tip_nodes: fewer in a tip are refined further, within `max_nodes`.
    """

    length_mm: float
    width_mm: float
    min_nodes: int
    max_nodes: int
    max_distance_mm: float
    max_volume_error: float
    min_quality: float
    tip_depth_mm: float
    min_tip_nodes: int


def mesh_height_field(surface: DrawnSurface, goal: MeshGoal) -> Tetrahedra:
    """Return the coarsest of a fixed series of meshes that is as fine and as close to the surface as asked.

    Args:
        surface: closed, with its base at z = 0 and exactly as large as the goal says, its centre the origin.
        goal: what the mesh has to be.

    Raises:
        NotAHeightField: it has more than one height over a point.
        WallsTangled: walls cross.
        FeatureBelowResolution: no mesh with so few nodes is close enough.
    """
    field = HeightField(surface)
    best = None
    for cosine in _CREASE_COSINES:
        try:
            outlined = _outlined(list(field.lines(crease_cosine=cosine)), goal)
            for longest_mm in _LONGEST_MM:
                mesh = _meshed(field, deepcopy(outlined), longest_mm)
                best = _Deviation.measure(mesh, surface)
                if best.is_within(goal) and goal.min_nodes <= len(mesh.nodes_mm) <= goal.max_nodes:
                    return _refine_tips(mesh, goal)
        except TooManyPoints:
            continue
    raise FeatureBelowResolution(
        f"Expected features that a mesh of at most {goal.max_nodes} nodes follows within {goal.max_distance_mm} mm, "
        f"got {best or 'outlines that need more nodes'}; remove rounded edges and fine details, or bring a tet.msh."
    )


def _refine_tips(mesh: Tetrahedra, goal: MeshGoal) -> Tetrahedra:
    """Return the mesh with nodes enough in its tips, or with half or less of them where tetrahedra get too flat."""
    fewest = goal.min_tip_nodes
    while fewest > 1:
        finer = refined_tips(mesh, depth_mm=goal.tip_depth_mm, fewest=fewest, max_nodes=goal.max_nodes)
        if float(finer.qualities.min()) >= goal.min_quality:
            return finer
        fewest //= 2
    return mesh


@dataclass(frozen=True, kw_only=True)
class _Deviation:
    """How far a mesh is from what was drawn.

    Attributes:
        nodes: number of nodes.
        distance_mm: largest distance between the surfaces.
        volume_error: relative difference between the volumes.
        quality: of the worst tetrahedron.
    """

    nodes: int
    distance_mm: float
    volume_error: float
    quality: float

    @classmethod
    def measure(cls, mesh: Tetrahedra, surface: DrawnSurface) -> "_Deviation":
        return cls(
            nodes=len(mesh.nodes_mm),
            distance_mm=max_distance_mm(mesh.surface, surface),
            volume_error=abs(mesh.volume_mm3 / surface.volume_mm3 - 1.0),
            quality=float(mesh.qualities.min()),
        )

    def is_within(self, goal: MeshGoal) -> bool:
        return (
            self.distance_mm <= goal.max_distance_mm
            and self.volume_error <= goal.max_volume_error
            and self.quality >= goal.min_quality
        )

    def __str__(self) -> str:
        return (
            f"{self.nodes} nodes that are {self.distance_mm:.3f} mm off with a volume {self.volume_error:.2%} off and "
            f"a worst quality of {self.quality:.2g}"
        )


def max_distance_mm(first: DrawnSurface, second: DrawnSurface) -> float:
    """Return the largest distance of a point of either surface from the other [mm], at points about 0.5 mm apart."""
    there = farthest(first.samples_mm, second.vertices_mm, second.triangles)[1]
    back = farthest(second.samples_mm, first.vertices_mm, first.triangles)[1]
    return max(float(there), float(back))


def _outlined(lines: list[MeshLine], goal: MeshGoal) -> PlaneMesh:
    """Return the plane mesh of the base with the outlines of the faces and nothing else."""
    half_mm = (0.5 * goal.length_mm, 0.5 * goal.width_mm)
    plane = PlaneMesh(snap_to_grid(half_mm[0]), snap_to_grid(half_mm[1]), max_points=goal.max_nodes // 2)
    add_outlines(plane, lines, half_mm)
    return plane


def _meshed(field: HeightField, plane: PlaneMesh, longest_mm: float) -> Tetrahedra:
    columns = _refined(plane, field, longest_mm)
    return Tetrahedra(
        nodes_mm=np.array([(*convert_to_mm(plane.points[point]), height) for point, height in columns.nodes()]),
        corners=np.array(columns.tetrahedra(), dtype=np.int64),
    )


def _refined(plane: PlaneMesh, field: HeightField, longest_mm: float) -> Columns:
    """Refine a plane mesh until it is fine enough and follows the heights; return the columns over it."""
    probes_mm, faces = samples_of_triangles_mm(pulled_corners(field.upper_corners_mm, _INSIDE_MM))
    upward = field.upper_slopes[faces]
    shortest = _SHORTEST_MM * GRID_PER_MM
    for _ in range(_ROUNDS):
        plane.refine(longest=longest_mm * GRID_PER_MM, shortest=shortest)
        columns = _columns(plane, field)
        height_mm = heights_of_faces_mm(probes_mm[:, :2], probes_mm[:, :2], columns.top_corners_mm())
        error_mm = np.abs(height_mm - probes_mm[:, 2]) * upward
        added = [plane.add_near((snap_to_grid(x), snap_to_grid(y)), shortest) for x, y in _worst(probes_mm, error_mm)]
        if not any(added):
            break
    return columns


def _worst(probes_mm: FloatArray, error_mm: FloatArray) -> list[PlanePoint]:
    """Return x and y of the probes with the largest errors, those apart from each other."""
    chosen: list[PlanePoint] = []
    order = np.lexsort((probes_mm[:, 1], probes_mm[:, 0], -error_mm))
    for x, y in probes_mm[order[: int((error_mm > _ERROR_MM).sum())], :2].tolist():
        if all(abs(x - cx) > _APART_MM or abs(y - cy) > _APART_MM for cx, cy in chosen):
            chosen.append((x, y))
    return chosen


def _columns(plane: PlaneMesh, field: HeightField) -> Columns:
    triangles = plane.triangles
    corners_mm = np.array([[convert_to_mm(plane.points[corner]) for corner in triangle] for triangle in triangles])
    inside_mm = pulled_corners(corners_mm, _INSIDE_MM).reshape(-1, 2)
    heights_mm = heights_of_faces_mm(inside_mm, corners_mm.reshape(-1, 2), field.upper_corners_mm)
    return Columns(
        triangles, plane.walls, corners_mm=corners_mm, heights_mm=heights_mm.reshape(-1, 3), spacing_mm=_LAYER_MM
    )
