"""Stress and displacement of a gel, from its rest shape and where its nodes are. The colours of a picture.

Plain numpy: nothing here is on the way from an action to an observation.
"""

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]


def deformation_gradients(rest_m: FloatArray, positions_m: FloatArray, tetrahedra: IndexArray) -> FloatArray:
    """Return F = D_s D_m^-1 of linear tetrahedra, shape [t, 3, 3]; the columns of D are the edges from corner 0.

    Sifakis & Barbic, FEM Simulation of 3D Deformable Solids (2012), section 4.1.

    Args:
        rest_m: undeformed node positions [m], shape [n, 3].
        positions_m: present node positions [m], shape [n, 3], in any rotated and moved frame.
        tetrahedra: node indices, shape [t, 4].
    """
    return np.asarray(_edges(positions_m, tetrahedra) @ np.linalg.inv(_edges(rest_m, tetrahedra)))


def cauchy_stress_pa(F: FloatArray, *, youngs_modulus_pa: float, poisson_ratio: float) -> FloatArray:
    """Return the true stress of the gels' compressible neo-Hookean material [Pa], shape [t, 3, 3].

        sigma = (mu (B - I) + lambda ln J I) / J,   B = F F^T,   J = det F

    This is P F^T / J of the energy in `envs.fem.elastic.neo_hookean`; Bonet & Wood, Nonlinear Continuum Mechanics for
    Finite Element Analysis (2008), equation 6.29.

    Args:
        F: deformation gradients with positive determinant, shape [t, 3, 3].
        youngs_modulus_pa: [Pa].
        poisson_ratio: [-].
    """
    mu = youngs_modulus_pa / (2.0 * (1.0 + poisson_ratio))
    lam = youngs_modulus_pa * poisson_ratio / ((1.0 + poisson_ratio) * (1.0 - 2.0 * poisson_ratio))
    J = np.linalg.det(F)[:, None, None]
    B = F @ np.swapaxes(F, 1, 2)
    return np.asarray((mu * (B - np.eye(3)) + lam * np.log(J) * np.eye(3)) / J)


def von_mises_pa(stress_pa: FloatArray) -> FloatArray:
    """Return the equivalent stress sqrt(3/2 s : s) with the deviator s [Pa], shape [t, 3, 3] to [t]."""
    pressure = np.trace(stress_pa, axis1=1, axis2=2) / 3.0
    deviator = stress_pa - pressure[:, None, None] * np.eye(3)
    return np.asarray(np.sqrt(1.5 * (deviator * deviator).sum(axis=(1, 2))))


def nodal_means(values: FloatArray, rest_m: FloatArray, tetrahedra: IndexArray) -> FloatArray:
    """Return each node's mean of its tetrahedra's values, weighted by their rest volumes, [t, ...] to [n, ...]."""
    weights = np.repeat(np.abs(np.linalg.det(_edges(rest_m, tetrahedra))), 4)
    nodes, columns = tetrahedra.ravel(), np.repeat(values.reshape(len(values), -1), 4, axis=0).T
    totals = [np.bincount(nodes, weights * column, minlength=len(rest_m)) for column in columns]
    means = np.stack(totals, axis=1) / np.bincount(nodes, weights, minlength=len(rest_m))[:, None]
    return np.asarray(means.reshape(len(rest_m), *values.shape[1:]))


def contact_pressure_pa(stress_pa: FloatArray, positions_m: FloatArray, triangles: IndexArray) -> FloatArray:
    """Return how hard a surface is pressed at its nodes: -n . sigma n, and 0 where it is pulled [Pa], shape [n].

    Args:
        stress_pa: true stress at the nodes [Pa], shape [n, 3, 3].
        positions_m: of the nodes [m], shape [n, 3].
        triangles: of the surface, indices of the nodes, shape [t, 3], all turning the same way.
    """
    corners = positions_m[triangles]
    area_vectors = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = np.zeros_like(positions_m)
    np.add.at(normals, triangles, area_vectors[:, None, :])
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    normals = np.divide(normals, lengths, out=np.zeros_like(normals), where=lengths > 0)
    return np.asarray(np.maximum(0.0, -np.einsum("ni,nij,nj->n", normals, stress_pa, normals)))


def displacement_m(
    rest_m: FloatArray, positions_m: FloatArray, rotation: FloatArray, translation_m: FloatArray
) -> FloatArray:
    """Return the distance of every node from where it would be in the undeformed gel at this pose [m], shape [n].

    Args:
        rest_m: undeformed node positions in the gel's frame [m], shape [n, 3].
        positions_m: world positions [m], shape [n, 3].
        rotation: world from gel, shape [3, 3].
        translation_m: of the gel's origin in the world [m], shape [3].
    """
    moved = positions_m - (rest_m @ rotation.T + translation_m)
    return np.asarray(np.sqrt((moved * moved).sum(axis=1)))


def _edges(positions_m: FloatArray, tetrahedra: IndexArray) -> FloatArray:
    """Return the edge vectors from corner 0 to corners 1, 2, 3 as columns, shape [t, 3, 3]."""
    corners = positions_m[tetrahedra]
    return np.asarray(np.swapaxes(corners[:, 1:] - corners[:, :1], 1, 2))
