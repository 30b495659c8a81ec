"""The rigid parts of the fusion task, and where they lie among the challenge's own files."""

import numpy as np

from ...assets import Meshes
from ...errors import VitacError
from ...fem.model.mesh import SurfaceMesh
from ...geometry.bases import RIM_MM, base_surface, hexagon_bottom_vertices, hexagon_peg_surface
from ...geometry.pegs import PegShape, bottom_vertices, peg_surface
from .variation import Target


class BaseElsewhere(VitacError):
    """The base in the assets folder does not stand where the task expects it; use the one with 2.0 mm of clearance."""


def peg_mesh(meshes: Meshes, target: Target) -> SurfaceMesh:
    """Return the peg for this hole."""
    if target is Target.LEFT:
        return meshes.part(hexagon_peg_surface, "peg_in_hole/hexagon_peg.STL")
    return meshes.part(lambda: peg_surface(PegShape.CUBOID), "peg_in_hole/cuboid_peg.STL")


def peg_bottom(peg: SurfaceMesh, target: Target) -> "np.ndarray[tuple[int], np.dtype[np.int64]]":
    """Find the vertices at the lower corners of a peg, in the order of the logs."""
    found = hexagon_bottom_vertices(peg) if target is Target.LEFT else bottom_vertices(PegShape.CUBOID, peg)
    return np.asarray(found, dtype=np.int64)


def base_mesh(meshes: Meshes, clearance_mm: float) -> SurfaceMesh:
    """Return the base with both holes and garages.

    Raises:
        BaseElsewhere: it was read from a file that has another origin, as the challenge's with 1.0 mm has.
    """
    base = meshes.part(lambda: base_surface(clearance_mm), f"peg_in_hole/sim_hole_base_{clearance_mm:.1f}mm.STL")
    rim_mm = float(base.vertices_m[:, 2].max()) * 1e3
    if abs(rim_mm - RIM_MM) > 1e-3:
        raise BaseElsewhere(f"The rim of {base.name} is {rim_mm:.3f} mm high, expected {RIM_MM:g} mm.")
    return base
