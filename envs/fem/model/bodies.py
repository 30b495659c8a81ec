"""What a scene is made of: gels and rigid parts, with their materials and where they are placed."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .mesh import GelMesh, SurfaceMesh

FloatArray = NDArray[np.float64]

# Materials of bodies that are given no other.
GEL_MATERIAL = "gel"
PART_MATERIAL = "part"


@dataclass(frozen=True, kw_only=True, eq=False)
class GelBody:
    """A gel in a scene, placed by world = rotation @ rest + translation.

    Attributes:
        mesh: tetrahedral mesh.
        rotation: shape [3, 3].
        translation_m: [m], shape [3].
        youngs_modulus_pa: Young's modulus [Pa].
        poisson_ratio: Poisson's ratio [-].
        density_kg_m3: density [kg/m^3].
        friction: friction coefficient [-], for contact models that take the mean of two bodies.
        material: its name, for contact models with friction coefficients by pair of materials.
    """

    mesh: GelMesh
    rotation: FloatArray
    translation_m: FloatArray
    youngs_modulus_pa: float = 3e5
    poisson_ratio: float = 0.3
    density_kg_m3: float = 1000.0
    friction: float = 87.5
    material: str = GEL_MATERIAL


@dataclass(frozen=True, kw_only=True, eq=False)
class RigidBody:
    """A rigid part in a scene (an affine body), placed by world = rotation @ body + translation.

    A fixed one never moves.
    """

    mesh: SurfaceMesh
    rotation: FloatArray
    translation_m: FloatArray
    density_kg_m3: float = 500.0
    friction: float = 1.0
    material: str = PART_MATERIAL
    fixed: bool = False
