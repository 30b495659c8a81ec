"""Whole gels without contact, against closed forms and against scikit-fem."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from block_meshes import box_gel
from engine_probe import Probe
from numpy.typing import NDArray
from small_scenes import IDENTITY, driven_positions_m
from vectors import random_rotation
from vitac.envs.fem.model.mesh import GelBody, GelMesh
from vitac.envs.fem.scene.report import StepStatus
from vitac.envs.fem.scene.scene import Scene

FloatArray = NDArray[np.float64]
MU_PA, LAMBDA_PA = 3e5 / 2.6, 3e5 * 0.3 / (1.3 * 0.4)
# So slow that inertia is nothing.
TIME_STEP_S = 1e3


def solved(mesh: GelMesh, targets_m: FloatArray, *, rotation: FloatArray = IDENTITY) -> Scene:
    """The gel at rest with its driven nodes at their targets."""
    gel = GelBody(mesh=mesh, rotation=rotation, translation_m=np.zeros(3))
    scene = Scene(gels=[gel], bodies=[], time_step_s=TIME_STEP_S)
    start = driven_positions_m(gel)
    for part in (0.5, 1.0):
        report = scene.step(driven_targets_m=[start + part * (targets_m - start)])
        assert report.status is StepStatus.CONVERGED
    return scene


def clamped_everywhere(mesh: GelMesh) -> GelMesh:
    """The same mesh with its whole surface driven."""
    driven = np.zeros(len(mesh.rest_position_m), dtype=bool)
    driven[mesh.surface_nodes] = True
    return replace(mesh, driven=driven)


@pytest.mark.parametrize("seed", range(3))
def test_patch_test_any_affine_boundary_motion_is_reproduced_inside(seed: int) -> None:
    mesh = clamped_everywhere(box_gel((0.006, 0.005, 0.004), (3, 3, 3), jitter=0.25))
    random = np.random.default_rng(seed)
    F = np.eye(3) + 0.15 * random.uniform(-1, 1, (3, 3))
    expected = mesh.rest_position_m @ F.T
    scene = solved(mesh, expected[mesh.driven_nodes])
    np.testing.assert_allclose(scene.gel_positions_m(0), expected, atol=1e-11)


def test_rigid_motion_of_the_back_moves_the_whole_gel_rigidly() -> None:
    mesh = box_gel((0.006, 0.005, 0.004), (3, 3, 2), jitter=0.2)
    turn = np.array([[np.cos(0.5), -np.sin(0.5), 0], [np.sin(0.5), np.cos(0.5), 0], [0, 0, 1]])
    shift = np.array([0.01, -0.02, 0.005])
    scene = solved(mesh, mesh.rest_position_m[mesh.driven_nodes] @ turn.T + shift)
    np.testing.assert_allclose(scene.gel_positions_m(0), mesh.rest_position_m @ turn.T + shift, atol=1e-9)


def test_the_answer_turns_with_the_frame() -> None:
    mesh = box_gel((0.006, 0.005, 0.004), (3, 2, 2), driven="ends", jitter=0.2)
    pressed = mesh.rest_position_m[mesh.driven_nodes] + [0.0003, 0.0, 0.0] * (
        mesh.rest_position_m[mesh.driven_nodes][:, 2:] > 0.002
    )
    turn = random_rotation(np.random.default_rng(5))
    upright = solved(mesh, pressed).gel_positions_m(0)
    turned = solved(mesh, pressed @ turn.T, rotation=turn).gel_positions_m(0)
    np.testing.assert_allclose(turned, upright @ turn.T, atol=1e-10)


@pytest.mark.parametrize("stretch", [0.6, 0.9, 1.2])
def test_confined_compression_gives_the_closed_form_force(stretch: float) -> None:
    """Uniaxial strain of a block: P = mu (s - 1/s) + lambda ln(s) / s on its rest area."""
    size = (0.006, 0.005, 0.004)
    mesh = clamped_everywhere(box_gel(size, (3, 3, 4)))
    scene = solved(mesh, (mesh.rest_position_m * [1, 1, stretch])[mesh.driven_nodes])
    top = np.flatnonzero(mesh.rest_position_m[:, 2] > size[2] * 0.999)
    force = Probe(scene).at(scene._x).all_forces_n[top].sum(axis=0)
    stress = MU_PA * (stretch - 1 / stretch) + LAMBDA_PA * np.log(stretch) / stretch
    assert force[2] == pytest.approx(stress * size[0] * size[1], rel=1e-9)
    np.testing.assert_allclose(force[:2], 0, atol=1e-9)


def bonded_compression_force_n(cells: int) -> float:
    """Force that shortens a cube of 4 mm with bonded ends by a tenth."""
    mesh = box_gel((0.004, 0.004, 0.004), (cells, cells, cells), driven="ends")
    top = mesh.rest_position_m[:, 2] > 0.0039
    targets = mesh.rest_position_m - [0, 0, 4e-4] * top[:, None]
    scene = solved(mesh, targets[mesh.driven_nodes])
    forces = Probe(scene).at(scene._x).all_forces_n
    assert np.linalg.norm(forces.sum(axis=0)) < 1e-6
    return -float(forces[top].sum(axis=0)[2])


def test_refining_the_mesh_converges_from_the_stiff_side() -> None:
    forces = [bonded_compression_force_n(cells) for cells in (2, 4, 8)]
    assert forces[0] > forces[1] > forces[2] > 0.9 * forces[0]
    assert forces[0] - forces[1] > 2.0 * (forces[1] - forces[2])


def skfem_solution(mesh: GelMesh, targets_m: FloatArray) -> FloatArray:
    """Positions of all nodes by scikit-fem: own assembly and quadrature, Newton with a sparse direct solver."""
    from skfem import (  # type: ignore[import-untyped]
        Basis,
        BilinearForm,
        ElementTetP1,
        ElementVector,
        LinearForm,
        MeshTet,
        condense,
        solve,
    )
    from skfem.helpers import ddot, det, grad, inv, transpose  # type: ignore[import-untyped]

    basis = Basis(
        MeshTet(mesh.rest_position_m.T.copy(), mesh.tetrahedra.T.copy()), ElementVector(ElementTetP1()), intorder=1
    )
    identity = np.eye(3)[:, :, None, None]

    def kinematics(w: Any) -> tuple[FloatArray, FloatArray, FloatArray]:
        F = grad(w["u"]) + identity
        return F, transpose(inv(F)), np.log(det(F))

    @BilinearForm  # type: ignore[untyped-decorator]
    def tangent(u: Any, v: Any, w: Any) -> Any:
        _, F_it, log_j = kinematics(w)
        dF = grad(u)
        # d(F^-T) = -F^-T dF^T F^-T
        turned = np.einsum("ijkl,mjkl,mnkl->inkl", F_it, dF, F_it)
        stress = MU_PA * dF + (MU_PA - LAMBDA_PA * log_j) * turned + LAMBDA_PA * ddot(F_it, dF) * F_it
        return ddot(stress, grad(v))

    @LinearForm  # type: ignore[untyped-decorator]
    def internal(v: Any, w: Any) -> Any:
        F, F_it, log_j = kinematics(w)
        return ddot(MU_PA * (F - F_it) + LAMBDA_PA * log_j * F_it, grad(v))

    fixed = basis.nodal_dofs[:, mesh.driven_nodes].ravel()
    u = np.zeros(basis.N)
    wanted = (targets_m - mesh.rest_position_m[mesh.driven_nodes]).T.ravel()
    for part in (0.25, 0.5, 0.75, 1.0, 1.0):
        for _ in range(8):
            field = basis.interpolate(u)
            step = np.zeros(basis.N)
            step[fixed] = part * wanted - u[fixed]
            u = u + solve(
                *condense(tangent.assemble(basis, u=field), -internal.assemble(basis, u=field), x=step, D=fixed)
            )
    return np.asarray(mesh.rest_position_m + u[basis.nodal_dofs].T)


def test_a_press_by_prescribed_displacement_agrees_with_scikit_fem() -> None:
    """A dome is pressed into the middle of the sensing face by moving nodes there; back face held."""
    block = box_gel((0.012, 0.010, 0.004), (6, 5, 3), jitter=0.2)
    top = block.rest_position_m[:, 2] > 0.0039
    distance = np.linalg.norm(block.rest_position_m[:, :2] - [0.006, 0.005], axis=1)
    mesh = replace(block, driven=block.driven | (top & (distance < 0.0035)))
    depth = 0.8e-3 * np.clip(1 - (distance / 0.006) ** 2, 0, None) * top
    targets = (block.rest_position_m - depth[:, None] * [0, 0, 1] + 0.3 * depth[:, None] * [1, 0, 0])[mesh.driven_nodes]
    ours = solved(mesh, targets).gel_positions_m(0)
    theirs = skfem_solution(mesh, targets)
    assert np.abs(theirs - block.rest_position_m).max() > 5e-4
    np.testing.assert_allclose(ours, theirs, atol=1e-9)
