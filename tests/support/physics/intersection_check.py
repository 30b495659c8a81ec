"""Whether bodies intersect and how near they are, by the IPC Toolkit, which shares no code with the engine."""

from collections.abc import Sequence

import ipctk  # type: ignore[import-not-found]
import numpy as np
from numpy.typing import NDArray
from vitac.envs.fem.model.mesh import GelMesh, SurfaceMesh, unique_edges
from vitac.envs.scene.grasped_scene import GraspedScene

FloatArray = NDArray[np.float64]


class IntersectionCheck:
    """Whether any two different bodies intersect; a body's contact with itself is not asked for."""

    def __init__(self, meshes: Sequence[GelMesh | SurfaceMesh]) -> None:
        ipctk.set_num_threads(1)
        triangles, patches, rest, count = [], [], [], 0
        for index, mesh in enumerate(meshes):
            points = mesh.rest_position_m if isinstance(mesh, GelMesh) else mesh.vertices_m
            faces = mesh.surface_triangles if isinstance(mesh, GelMesh) else mesh.triangles
            triangles.append(faces + count)
            patches.append(np.full(len(points), index, dtype=np.int32))
            rest.append(points)
            count += len(points)
        faces = np.concatenate(triangles)
        self.mesh = ipctk.CollisionMesh(
            np.asfortranarray(np.concatenate(rest)),
            np.asfortranarray(unique_edges(faces).astype(np.int32)),
            np.asfortranarray(faces.astype(np.int32)),
        )
        self.mesh.can_collide = ipctk.make_vertex_patches_filter(np.concatenate(patches))

    def intersects(self, positions_m: Sequence[FloatArray]) -> bool:
        """Whether the bodies intersect at these world positions [m] of all nodes or vertices."""
        return bool(ipctk.has_intersections(self.mesh, np.asfortranarray(np.concatenate(positions_m))))

    def smallest_distance_m(self, positions_m: Sequence[FloatArray], reach_m: float) -> float:
        """Smallest distance of two different bodies [m], infinite if that is beyond the reach."""
        vertices, candidates = np.asfortranarray(np.concatenate(positions_m)), ipctk.Candidates()
        candidates.build(self.mesh, vertices, reach_m)
        found = [*candidates.fv_candidates, *candidates.ee_candidates]
        squared = [pair.compute_distance(vertices, self.mesh.edges, self.mesh.faces) for pair in found]
        nearest_m = float(np.sqrt(min(squared, default=np.inf)))
        return nearest_m if nearest_m < reach_m else np.inf


class GraspedSceneCheck:
    """The check for a part held between two gels."""

    def __init__(self, grasped: GraspedScene) -> None:
        self._check = IntersectionCheck([grasped.gel, grasped.gel, grasped.held_surface, grasped.fixed.mesh])

    def intersects(self, grasped: GraspedScene) -> bool:
        """Whether the scene, as it stands, has intersecting bodies."""
        return self._check.intersects(_positions_m(grasped))

    def smallest_gap_m(self, grasped: GraspedScene) -> float:
        """Smallest distance of two bodies [m], infinite where the barrier does not reach."""
        return self._check.smallest_distance_m(_positions_m(grasped), grasped.physics.contact.d_hat_m)


def _positions_m(grasped: GraspedScene) -> list[FloatArray]:
    held = grasped.held_vertices_m(np.arange(len(grasped.held_surface.vertices_m)))
    fixed = (grasped.fixed.rotation[None] * grasped.fixed.mesh.vertices_m[:, None]).sum(axis=2)
    place_m = grasped.fixed.translation_m + grasped.fixed_shift_m()
    return [grasped.gel_nodes_m(0), grasped.gel_nodes_m(1), held, fixed + place_m]
