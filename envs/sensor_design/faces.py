"""Which faces of a gel's mesh are driven and which sense: found from its geometry, never from a list of nodes."""

import numpy as np
from numpy.typing import NDArray

from ..fem.model.mesh import GelMesh, MeshError
from .tetrahedra import Tetrahedra

IndexArray = NDArray[np.int64]

MILLIMETRE_M = 1e-3
# A sensing face leans at most 60 degrees from the base's plane, as cosine.
_SENSING_COSINE = 0.5


def make_gel(mesh: Tetrahedra, *, name: str) -> tuple[GelMesh, IndexArray]:
    """Return the gel of a mesh, with the middle of its thickness at z = 0, and its sensing triangles, shape [s, 3].

    The faces in the plane of the base are driven. Faces of the outer shell that lean at most 60 degrees from that plane
    and look away from it sense.

    Args:
        mesh: with its base at z = 0, in mm.
        name: how messages call it.

    Raises:
        MeshError: it cannot be simulated.
    """
    surface = mesh.surface
    if len(surface.triangles) == 0:
        raise MeshError(f"{name} has no outer surface: expected each tetrahedron once.")
    slope = surface.area_vectors_mm2[:, 2] / surface.areas_mm2
    outer = surface.shells == int(surface.shell_volumes_mm3().argmax())
    sensing = surface.triangles[(slope >= _SENSING_COSINE) & outer]
    middle = np.array([0.0, 0.0, 0.5 * float(mesh.nodes_mm[:, 2].max())])
    gel = GelMesh(
        rest_position_m=(mesh.nodes_mm - middle) * MILLIMETRE_M,
        tetrahedra=mesh.corners,
        driven=_mask(surface.triangles[mesh.base_faces], len(mesh.nodes_mm)),
        sensing=_mask(sensing, len(mesh.nodes_mm)),
        name=name,
    )
    return gel, sensing


def _mask(triangles: IndexArray, nodes: int) -> NDArray[np.bool_]:
    mask = np.zeros(nodes, dtype=np.bool_)
    mask[triangles.reshape(-1)] = True
    return mask
