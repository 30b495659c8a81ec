"""Hexahedra: derivatives, affine states, turns, and bending against theory."""

from dataclasses import replace

import numpy as np
import pytest
from contact.beams import bent_over_theory
from engine_probe import dense_matrix
from numpy.typing import NDArray
from vitac.envs.fem.elastic.hexahedra import add_hexahedra, new_hexahedron_scratch
from vitac.envs.fem.elastic.neo_hookean import lame_parameters_pa
from vitac.envs.fem.model.mesh import GelBody, GelMesh, MeshError, PronyBranch
from vitac.envs.fem.model.model import EXACT_MATRIX, NO_MATRIX, PROJECTED_MATRIX, Model, new_newton_system
from vitac.envs.fem.model.settings import ContactSettings, SolverSettings
from vitac.envs.fem.scene.builder import build_model
from vitac.envs.fem.scene.layout import NodeLayout
from vitac.envs.tactile.gel import GelCells, structured_gel

FloatArray = NDArray[np.float64]

MODULUS_PA = 2.3e5


def model_of(
    mesh: GelMesh,
    poisson_ratio: float = 0.41,
    rotation: FloatArray | None = None,
    viscosity: tuple[PronyBranch, ...] = (),
    yeoh: tuple[float, float] = (0.0, 0.0),
) -> Model:
    gel = GelBody(
        mesh=mesh,
        rotation=np.eye(3) if rotation is None else rotation,
        translation_m=np.zeros(3),
        youngs_modulus_pa=MODULUS_PA,
        poisson_ratio=poisson_ratio,
        viscosity=viscosity,
        yeoh=yeoh,
    )
    return build_model(NodeLayout((gel,), ()), 0.1, ContactSettings(), SolverSettings())


class Probe:
    """Forces [N] and matrices [N/m] of the elasticity of a model."""

    def __init__(self, model: Model, nodes: int, held_pa: FloatArray | None = None) -> None:
        self.model = model
        self.system = new_newton_system(model.system, nodes)
        self._scratch = new_hexahedron_scratch(0 if held_pa is None else len(held_pa))
        if held_pa is not None:
            self._scratch.held_pa[:] = held_pa

    def forces_n(self, x: FloatArray, matrix: int = NO_MATRIX, move: FloatArray | None = None) -> FloatArray:
        for array in (self.system.gradient, self.system.entries, self.system.coupling):
            array[:] = 0.0
        self.system.moves[0] = move is not None
        self.system.prescribed_move[:] = 0.0 if move is None else move
        add_hexahedra(self.model.hexahedra, np.ascontiguousarray(x), self._scratch, self.system, matrix)
        return self.system.gradient.copy()

    def matrix_n_m(self, x: FloatArray, matrix: int = EXACT_MATRIX) -> FloatArray:
        self.forces_n(x, matrix)
        return dense_matrix(self.model.system, self.system.entries)


def turn(seed: int) -> FloatArray:
    axes, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    return np.asarray(axes * np.sign(np.linalg.det(axes)))


@pytest.fixture(scope="module")
def bevelled() -> GelMesh:
    return structured_gel(name="bevelled", cells=GelCells(x=3, y=2, layers=2, growth=1.4, is_hexahedral=True))


def strained(mesh: GelMesh, seed: int = 0) -> FloatArray:
    """Node positions [m] that are turned, stretched and disturbed by a tenth of a cell."""
    random = np.random.default_rng(seed)
    stretch = np.eye(3) + 0.2 * random.uniform(-1, 1, (3, 3))
    x = mesh.rest_position_m @ (turn(seed) @ stretch).T
    return np.asarray(x + 1e-4 * random.normal(size=x.shape))


BRANCHES = (
    PronyBranch(modulus_ratio=0.7, relaxation_time_s=0.3),
    PronyBranch(modulus_ratio=0.2, relaxation_time_s=4.0),
)


NEO_HOOKEAN, YEOH = (0.0, 0.0), (-0.13, 0.21)


@pytest.mark.parametrize(("viscosity", "yeoh"), [((), NEO_HOOKEAN), (BRANCHES, NEO_HOOKEAN), (BRANCHES, YEOH)])
def test_matrix_is_the_derivative_of_the_forces(
    bevelled: GelMesh, viscosity: tuple[PronyBranch, ...], yeoh: tuple[float, float]
) -> None:
    x = strained(bevelled)
    held_pa = 1e4 * np.random.default_rng(3).normal(size=(len(bevelled.hexahedra), 6))
    held_pa[:, :3] -= held_pa[:, :3].mean(axis=1, keepdims=True)
    probe = Probe(model_of(bevelled, viscosity=viscosity, yeoh=yeoh), len(x), held_pa)
    matrix, unknowns = probe.matrix_n_m(x), probe.model.unknowns.node
    for direction in np.random.default_rng(1).normal(size=(3, *x.shape)):
        move = np.where(bevelled.driven[:, None], 0.0, direction)
        slope = (probe.forces_n(x + 1e-8 * move) - probe.forces_n(x - 1e-8 * move)) / 2e-8
        assert matrix @ move[unknowns].ravel() == pytest.approx(slope[unknowns].ravel(), abs=1e-6 * abs(slope).max())
    assert matrix == pytest.approx(matrix.T, abs=1e-12 * abs(matrix).max())


def test_coupling_is_the_derivative_by_the_prescribed_nodes(bevelled: GelMesh) -> None:
    x = strained(bevelled)
    probe = Probe(model_of(bevelled), len(x))
    move = np.where(bevelled.driven[:, None], np.random.default_rng(2).normal(size=x.shape), 0.0)
    probe.forces_n(x, EXACT_MATRIX, move)
    coupling, unknowns = probe.system.coupling.copy(), probe.model.unknowns.node
    slope = (probe.forces_n(x + 1e-8 * move) - probe.forces_n(x - 1e-8 * move)) / 2e-8
    assert coupling[unknowns] == pytest.approx(slope[unknowns], abs=1e-6 * abs(slope).max())


@pytest.mark.parametrize("yeoh", [NEO_HOOKEAN, YEOH])
@pytest.mark.parametrize("seed", range(4))
def test_projected_matrix_is_positive_semi_definite(bevelled: GelMesh, seed: int, yeoh: tuple[float, float]) -> None:
    x = strained(bevelled, seed) * np.array([1.0, 1.0, 0.5])
    matrix = Probe(model_of(bevelled, 0.48, yeoh=yeoh), len(x)).matrix_n_m(x, PROJECTED_MATRIX)
    eigenvalues = np.linalg.eigvalsh(0.5 * (matrix + matrix.T))
    assert eigenvalues.min() >= -1e-9 * eigenvalues.max()


@pytest.mark.parametrize(
    ("poisson_ratio", "yeoh"), [(0.0, NEO_HOOKEAN), (0.3, NEO_HOOKEAN), (0.49, NEO_HOOKEAN), (0.4, YEOH)]
)
def test_an_affine_state_has_the_energy_of_the_material_and_no_inner_forces(
    bevelled: GelMesh, poisson_ratio: float, yeoh: tuple[float, float]
) -> None:
    """Patch test, and the work along the way from rest to the state."""
    F = np.array([[1.2, 0.1, 0.0], [0.0, 0.9, -0.1], [0.05, 0.0, 1.1]])
    rest, mesh = bevelled.rest_position_m, bevelled
    probe = Probe(model_of(mesh, poisson_ratio, yeoh=yeoh), len(rest))
    inner = ~mesh.driven & ~np.isin(np.arange(len(rest)), mesh.surface_nodes)
    forces = probe.forces_n(rest @ F.T)
    assert inner.any()
    assert forces[inner] == pytest.approx(0.0, abs=1e-9 * abs(forces).max())
    points, weights = np.polynomial.legendre.leggauss(12)
    path = [np.eye(3) + (0.5 + 0.5 * p) * (F - np.eye(3)) for p in points]
    work = sum(
        0.5 * w * (probe.forces_n(rest @ A.T) * (rest @ (F - np.eye(3)).T)).sum()
        for w, A in zip(weights, path, strict=True)
    )
    mu, lam = lame_parameters_pa(MODULUS_PA, poisson_ratio)
    log_j = np.log(np.linalg.det(F))
    e, (second, third) = (F * F).sum() - 3.0, yeoh
    density = 0.5 * mu * (e + second * e**2 + third * e**3) - mu * log_j + 0.5 * lam * log_j**2
    assert work == pytest.approx(density * mesh.blocks.volume_m3.sum(), rel=1e-6)


def test_forces_turn_with_the_gel(bevelled: GelMesh) -> None:
    x, R = strained(bevelled, 5), turn(7)
    here = Probe(model_of(bevelled), len(x)).forces_n(x)
    turned = Probe(model_of(bevelled, rotation=R), len(x)).forces_n(x @ R.T)
    assert turned == pytest.approx(here @ R.T, abs=1e-11 * abs(here).max())


@pytest.mark.parametrize("poisson_ratio", [0.3, 0.48])
@pytest.mark.parametrize("seed", range(3))
def test_a_cantilever_with_two_cells_across_bends_as_timoshenko_says(poisson_ratio: float, seed: int) -> None:
    assert bent_over_theory(np.random.default_rng(seed), poisson_ratio, 2) == pytest.approx(1.0, abs=0.05)


def test_hexahedra_that_the_tetrahedra_do_not_cut_are_refused(bevelled: GelMesh) -> None:
    with pytest.raises(MeshError, match="do not cut 29 hexahedra; expected 5 of the corners"):
        replace(bevelled, hexahedra=bevelled.hexahedra[:29])
    with pytest.raises(MeshError, match="order its nodes with x fastest, then y, then z"):
        replace(bevelled, hexahedra=np.ascontiguousarray(bevelled.hexahedra[:, ::-1]))
