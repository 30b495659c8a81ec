"""The rigid parts of the peg task, and where they lie among the challenge's own files."""

from ...assets import Meshes
from ...fem.model.mesh import SurfaceMesh
from ...geometry.pegs import PegShape, hole_surface, peg_surface


def peg_mesh(meshes: Meshes, shape: PegShape) -> SurfaceMesh:
    """Return the peg of this shape."""
    return meshes.part(lambda: peg_surface(shape), f"peg_in_hole/{shape}_peg.STL")


def hole_mesh(meshes: Meshes, shape: PegShape) -> SurfaceMesh:
    """Return the plate with the hole for this peg, 1.5 mm of clearance per side."""
    return meshes.part(lambda: hole_surface(shape), f"peg_in_hole/{shape}_hole_1.5mm.STL")
