"""Run as a program: forces and stiffness of a strained block, by the sources that it finds to import from.

Usage: python elastic_probe.py STATES.npz RESULTS.npz; states are node positions [m], shape [s, n, 3].
"""

import sys

import numpy as np
from block_meshes import box_gel
from engine_probe import dense_matrix
from numpy.typing import NDArray
from vitac.envs.fem.elastic.elasticity import add_elasticity, new_elastic_batch
from vitac.envs.fem.model.mesh import GelBody, GelMesh
from vitac.envs.fem.model.model import EXACT_MATRIX, PROJECTED_MATRIX, new_newton_system
from vitac.envs.fem.model.settings import ContactSettings, SolverSettings
from vitac.envs.fem.scene.builder import build_model
from vitac.envs.fem.scene.layout import NodeLayout

FloatArray = NDArray[np.float64]


def block() -> GelMesh:
    """A block of a few dozen tetrahedra, driven at its bottom."""
    return box_gel((3e-3, 2e-3, 2e-3), (3, 2, 2), jitter=0.1)


def main(states: str, results: str) -> None:
    """Write forces [N] of shape [s, u, 3], and exact and projected matrix [N/m] of the first state."""
    gels = (GelBody(mesh=block(), rotation=np.eye(3), translation_m=np.zeros(3)),)
    model = build_model(NodeLayout(gels, ()), 0.1, ContactSettings(), SolverSettings())
    positions = np.load(states)["x"]
    system, batch = new_newton_system(model.system, positions.shape[1]), new_elastic_batch()
    forces: list[FloatArray] = []
    matrices: dict[str, FloatArray] = {}
    for name, matrix in (("projected", PROJECTED_MATRIX), ("exact", EXACT_MATRIX)):
        for x in positions[: 1 if matrix == PROJECTED_MATRIX else None]:
            for array in (system.gradient, system.entries, system.coupling, system.moves):
                array[:] = 0
            add_elasticity(model.elastic, x, batch, system, matrix)
            matrices.setdefault(name, dense_matrix(model.system, system.entries))
            forces.append(system.gradient.copy())
    exact, projected = matrices["exact"], matrices["projected"]
    unknowns = model.unknowns.node
    np.savez(results, forces=np.array(forces[1:]), unknowns=unknowns, exact=exact, projected=projected)


if __name__ == "__main__":
    main(*sys.argv[1:])
