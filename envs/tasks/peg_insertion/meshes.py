"""The rigid parts of the peg task, and where they lie among the challenge's own files."""

from collections.abc import Callable

from ...assets import Meshes
from ...fem.model.mesh import SurfaceMesh
from ...geometry.pegs import CHALLENGE_FORM, PegForm, PegShape, hole_surface, peg_surface


def peg_mesh(meshes: Meshes, shape: PegShape, form: PegForm = CHALLENGE_FORM) -> SurfaceMesh:
    """Return the peg of this shape."""
    return _part(meshes, form, lambda: peg_surface(shape, form), f"{shape}_peg.STL")


def hole_mesh(meshes: Meshes, shape: PegShape, form: PegForm = CHALLENGE_FORM) -> SurfaceMesh:
    """Return the plate with the hole for this peg, 1.5 mm of clearance per side where the form has no other."""
    return _part(meshes, form, lambda: hole_surface(shape, form), f"{shape}_hole_1.5mm.STL")


def _part(meshes: Meshes, form: PegForm, generate: Callable[[], SurfaceMesh], file: str) -> SurfaceMesh:
    """Return a part; the challenge has files of its own form only, so all others are generated."""
    return meshes.part(generate, f"peg_in_hole/{file}") if form == CHALLENGE_FORM else generate()
