"""Cantilevers of hexahedra against Timoshenko's beam."""

from dataclasses import replace

import numpy as np
from block_meshes import hexahedral_box
from engine_probe import dense_matrix
from small_scenes import IDENTITY
from vitac.envs.fem.elastic.hexahedra import add_hexahedra, new_hexahedron_scratch
from vitac.envs.fem.model.mesh import GelBody
from vitac.envs.fem.model.model import EXACT_MATRIX, new_newton_system
from vitac.envs.fem.model.settings import ContactSettings, SolverSettings
from vitac.envs.fem.scene.builder import build_model
from vitac.envs.fem.scene.layout import NodeLayout


def bent_over_theory(rng: np.random.Generator, poisson_ratio: float, across: int) -> float:
    """Return the deflection of a drawn cantilever's end over that of Timoshenko's beam, by small strains."""
    height, width = rng.uniform(1e-3, 2e-3, 2)
    length, modulus_pa = rng.uniform(8.0, 12.0) * height, rng.uniform(5e4, 1e6)
    box = hexahedral_box((length, width, height), (round(across * length / height), across, across))
    rest = box.rest_position_m
    mesh = replace(box, driven=rest[:, 0] == 0.0)
    gel = GelBody(
        mesh=mesh, rotation=IDENTITY, translation_m=np.zeros(3), youngs_modulus_pa=modulus_pa,
        poisson_ratio=poisson_ratio,
    )  # fmt: skip
    model = build_model(NodeLayout((gel,), ()), 0.1, ContactSettings(), SolverSettings())
    system = new_newton_system(model.system, len(rest))
    for array in system:
        array[:] = 0
    add_hexahedra(model.hexahedra, rest, new_hexahedron_scratch(), system, EXACT_MATRIX)
    shares = np.isclose(rest[:, 0], length).astype(float)
    for axis, extent in ((1, width), (2, height)):
        shares *= np.where(np.isclose(rest[:, axis] % extent, 0.0) | np.isclose(rest[:, axis], extent), 0.5, 1.0)
    load = np.zeros_like(rest)
    load[:, 2] = shares / shares.sum()
    unknowns = model.unknowns.node
    moved = np.linalg.solve(dense_matrix(model.system, system.entries), load[unknowns].ravel()).reshape(-1, 3)
    shear_pa = modulus_pa / (2 * (1 + poisson_ratio))
    correction = 10 * (1 + poisson_ratio) / (12 + 11 * poisson_ratio)
    bending = length**3 / (3 * modulus_pa * width * height**3 / 12)
    theory = bending + length / (correction * shear_pa * width * height)
    return float((moved[:, 2] * load[unknowns, 2]).sum() / theory)
