"""Elastic forces and blocks of hexahedra with one point of quadrature, which lock neither in bending nor at any volume.

A hexahedron of rest volume V with nodes x_a knows two kinds of modes, weighted sums of its nodes: the columns
c_k = F e_k of its mean deformation gradient, and its four hourglass vectors q_m, which vanish in every affine motion:

    c_k = sum_a B_ak x_a,   B = the mean of dN_a/dX;      q_m = sum_a gamma_am x_a
    E = V psi(F) + 1/2 sum_mknl M_mknl Q_mk Q_nl,         Q_mk = c_k . q_m

The mean gradient is that of Flanagan & Belytschko, IJNME 17 (1981) 679. The stabilisation M is the energy that the
hourglass modes have in a box of the material under assumed strains (Belytschko & Bindeman, *Assumed strain
stabilization of the eight node hexahedral element*, CMAME 105 (1993) 225): bending without shear and with free lateral
strain, twisting by its shear. c_k . q_m is how the mode changes Green's strain, so rotations cost nothing. With

    h_m = eta zeta, xi zeta, xi eta, xi eta zeta,   a_k = 2 / L_k of a box of lengths L_k,   E' = E / (1 - nu^2)

    bending   1/2 V E'/3 (e_i^2 + e_j^2 + 2 nu e_i e_j),  e_i = a_i Q_ji, e_j = a_j Q_ij     for i < j
    twisting  1/2 V mu/3 (a_j Q_ii + a_i Q_jj)^2                                             for i < j
    the rest  1/2 V E/9 sum_k (a_k Q_3k)^2
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...compilation import kernel, large_kernel
from ...deterministic_math import natural_log
from ..algebra import (
    Mat3,
    Vec3,
    add_matrices,
    add_to_row,
    apply_rows,
    cross,
    dot,
    identity_and_outers,
    load,
    outer,
    scale,
    set_row,
    write_sum_of_seven,
)
from ..linear.system import GEL_STRIDE, add_block
from ..model.model import HEXAHEDRON_NODES as NODES
from ..model.model import MODES, NO_MATRIX, PROJECTED_MATRIX, Hexahedra, NewtonSystem, get_mode, weight_place
from .neo_hookean import lame_parameters_pa
from .viscosity import deviator
from .yeoh import yeoh_slopes

FloatArray = NDArray[np.float64]

COLUMNS = 3
HOURGLASS_VECTORS = MODES - COLUMNS


class HexahedronScratch(NamedTuple):
    """Scratch for one hexahedron."""

    modes: FloatArray  # [7, 3] its columns of F [-] and hourglass vectors [m]
    strain: FloatArray  # [4, 3] Q [m]
    stress: FloatArray  # [4, 3] sum M Q [J/m]
    inverse: FloatArray  # [3, 3] F^-T e_k in rows
    force: FloatArray  # [7, 3] dE by its modes
    jacobian: FloatArray  # [7, 7, 3, 3] derivative of that by the modes; zero between mode 6 and the other hourglasses
    rows: FloatArray  # of the modes by the nodes: component (i, k) of mode s by node b at 8 (9 s + 3 i + k) + b
    viscous: FloatArray  # [3, 3] stress of its viscous branches times the volume [J]
    held_pa: FloatArray  # [c, 6] `viscosity.held_stress_pa` of all hexahedra in this step; empty without viscosity
    block: FloatArray  # of the nodes [N/m]: component (i, k) of nodes a and b at 8 (9 a + 3 i + k) + b


def new_hexahedron_scratch(viscous: int = 0) -> HexahedronScratch:
    """Return scratch, for this number of hexahedra with viscosity."""
    return HexahedronScratch(
        modes=np.empty((MODES, 3)),
        strain=np.empty((HOURGLASS_VECTORS, 3)),
        stress=np.empty((HOURGLASS_VECTORS, 3)),
        inverse=np.empty((COLUMNS, 3)),
        force=np.empty((MODES, 3)),
        jacobian=np.zeros((MODES, MODES, 3, 3)),
        rows=np.empty(NODES * MODES * 9),
        viscous=np.empty((COLUMNS, 3)),
        held_pa=np.zeros((viscous, 6)),
        block=np.empty(NODES * NODES * 9),
    )


def stabilisation_n_m(
    volume_m3: FloatArray, size_m: FloatArray, youngs_modulus_pa: float, poisson_ratio: float
) -> FloatArray:
    """Return the numbers of M for hexahedra of these rest volumes [c] and lengths [c, 3], shape [c, 18].

    These are the 12 of the squares of Q_mk, at 3 m + k; of Q_ij Q_ji at 12 and of Q_ii Q_jj at 15, for (i, j) = (0, 1),
    (0, 2), (1, 2).
    """
    mu, _ = lame_parameters_pa(youngs_modulus_pa, poisson_ratio)
    bending = volume_m3 * youngs_modulus_pa / (3.0 * (1.0 - poisson_ratio * poisson_ratio))
    twisting, rest = volume_m3 * mu / 3.0, volume_m3 * youngs_modulus_pa / 9.0
    a = 2.0 / size_m
    squares = a * a
    numbers = np.empty((len(volume_m3), 18))
    for k in range(3):
        for m in range(3):
            numbers[:, 3 * m + k] = bending * squares[:, k]
        numbers[:, 4 * k] = twisting * (squares.sum(axis=1) - squares[:, k])
        numbers[:, 9 + k] = rest * squares[:, k]
    for pair, (i, j) in enumerate(((0, 1), (0, 2), (1, 2))):
        numbers[:, 12 + pair] = poisson_ratio * bending * a[:, i] * a[:, j]
        numbers[:, 15 + pair] = twisting * a[:, i] * a[:, j]
    return numbers


@large_kernel
def add_hexahedra(
    hexahedra: Hexahedra, x: FloatArray, scratch: HexahedronScratch, system: NewtonSystem, matrix: int
) -> float:
    """Add all hexahedra at nodes x [m]; return the smallest det F.

    Prescribed nodes, which move by the system's prescribed motion, are added to the coupling where they act on unknown
    ones.
    """
    smallest = np.inf
    for h in range(len(hexahedra.volume_m3)):
        for t in range(MODES):
            set_row(scratch.modes, t, get_mode(hexahedra, h, t, x))
        det_f, pressure = _write_forces(hexahedra, h, scratch)
        smallest = min(smallest, det_f)
        for a in range(NODES):
            total = (0.0, 0.0, 0.0)
            for t in range(MODES):
                w, f = hexahedra.weights[weight_place(h, t, a)], load(scratch.force, t)
                total = total[0] + w * f[0], total[1] + w * f[1], total[2] + w * f[2]
            add_to_row(system.gradient, hexahedra.nodes[h, a], total)
        if matrix != NO_MATRIX:
            _write_jacobian(hexahedra, h, pressure, scratch, matrix)
            _write_blocks(hexahedra, h, scratch)
            _add_blocks(hexahedra, h, scratch.block, system)
    return smallest


@kernel
def _pair(i: int, j: int) -> int:
    """Return the number of the pair of two different axes."""
    return i + j - 1


@kernel
def _write_forces(hexahedra: Hexahedra, h: int, scratch: HexahedronScratch) -> tuple[float, float]:
    """Write the forces on the modes, and what the Jacobian is made of; return det F and lambda ln J - mu [Pa]."""
    modes, strain, stress, force = scratch.modes, scratch.strain, scratch.stress, scratch.force
    numbers = hexahedra.stabilisation_n_m[h]
    for m in range(HOURGLASS_VECTORS):
        for k in range(COLUMNS):
            strain[m, k] = dot(load(modes, k), load(modes, COLUMNS + m))
    for m in range(HOURGLASS_VECTORS):
        for k in range(COLUMNS):
            stress[m, k] = numbers[3 * m + k] * strain[m, k]
    for i in range(COLUMNS):
        for j in range(COLUMNS):
            if i != j:
                stress[i, j] += numbers[12 + _pair(i, j)] * strain[j, i]
                stress[i, i] += numbers[15 + _pair(i, j)] * strain[j, j]
    c0, c1, c2 = load(modes, 0), load(modes, 1), load(modes, 2)
    n0, n1, n2 = cross(c1, c2), cross(c2, c0), cross(c0, c1)
    J = dot(c0, n0)
    for k in range(3):
        scratch.inverse[0, k], scratch.inverse[1, k], scratch.inverse[2, k] = n0[k] / J, n1[k] / J, n2[k] / J
    volume, mu = hexahedra.volume_m3[h], hexahedra.mu_pa[h]
    pressure = hexahedra.lambda_pa[h] * natural_log(J) - mu
    for k in range(COLUMNS):
        for i in range(3):
            total = volume * (mu * modes[k, i] + pressure * scratch.inverse[k, i])
            for m in range(HOURGLASS_VECTORS):
                total += stress[m, k] * modes[COLUMNS + m, i]
            force[k, i] = total
    if hexahedra.viscous_pa[h] > 0.0:
        _add_viscous_forces(hexahedra, h, (c0, c1, c2), scratch)
    if hexahedra.yeoh_pa[h, 0] != 0.0 or hexahedra.yeoh_pa[h, 1] != 0.0:
        first, _ = yeoh_slopes((c0, c1, c2), hexahedra.yeoh_pa[h, 0], hexahedra.yeoh_pa[h, 1])
        for k in range(COLUMNS):
            for i in range(3):
                force[k, i] += 2.0 * volume * first * modes[k, i]
    for m in range(HOURGLASS_VECTORS):
        for i in range(3):
            force[COLUMNS + m, i] = stress[m, 0] * c0[i] + stress[m, 1] * c1[i] + stress[m, 2] * c2[i]
    return J, pressure


@kernel
def _add_viscous_forces(hexahedra: Hexahedra, h: int, F: Mat3, scratch: HexahedronScratch) -> None:
    """Write S = 2 V (G dev E - what the branches hold) and add sum_j S_kj c_j to the forces on the columns."""
    viscous, force, e = scratch.viscous, scratch.force, deviator(F)
    for k in range(COLUMNS):
        for j in range(COLUMNS):
            n = k if k == j else COLUMNS + _pair(k, j)
            viscous[k, j] = 2.0 * hexahedra.volume_m3[h] * (hexahedra.viscous_pa[h] * e[n] - scratch.held_pa[h, n])
            for i in range(3):
                force[k, i] += viscous[k, j] * F[j][i]


@kernel
def _add_viscous_jacobian(factor: float, c: Mat3, scratch: HexahedronScratch, matrix: int) -> None:
    """Add the derivative of those forces by the columns; factor is V G [J].

    With dE_kl = (dc_k . c_l + c_k . dc_l) / 2 block (k, j) is
    V G (delta_kj sum_l c_l c_l^T + c_j c_k^T - 2/3 c_k c_j^T) + S_kj I, whose last term a positive semi-definite
    replacement leaves out.
    """
    jacobian, viscous = scratch.jacobian, scratch.viscous
    for k in range(COLUMNS):
        for j in range(COLUMNS):
            _add_outer(jacobian[k, k], factor, c[j], c[j])
            _add_outer(jacobian[k, j], factor, c[j], c[k])
            _add_outer(jacobian[k, j], -2.0 / 3.0 * factor, c[k], c[j])
            if matrix != PROJECTED_MATRIX:
                for i in range(3):
                    jacobian[k, j, i, i] += viscous[k, j]


@kernel
def _add_yeoh_jacobian(own: float, mixed: float, c: Mat3, jacobian: FloatArray) -> None:
    """Add own I to the blocks of the columns' own, and mixed c_k c_j^T to all of theirs."""
    for k in range(COLUMNS):
        for j in range(COLUMNS):
            _add_outer(jacobian[k, j], mixed, c[k], c[j])
        for i in range(3):
            jacobian[k, k, i, i] += own


@kernel
def _add_outer(block: FloatArray, factor: float, a: Vec3, b: Vec3) -> None:
    """Add the factor times a b^T to a block of shape [3, 3]."""
    for i in range(3):
        for k in range(3):
            block[i, k] += factor * a[i] * b[k]


@kernel
def _plus_outer(block: Mat3, factor: float, a: Vec3, b: Vec3) -> Mat3:
    """Return the rows of a block plus the factor times a b^T."""
    return add_matrices(block, outer(scale(factor, a), b))


@kernel
def _plus_diagonal(block: Mat3, s: float) -> Mat3:
    """Return the rows of a block plus s I."""
    return (
        (block[0][0] + s, block[0][1], block[0][2]),
        (block[1][0], block[1][1] + s, block[1][2]),
        (block[2][0], block[2][1], block[2][2] + s),
    )


@kernel
def _set_both(jacobian: FloatArray, s: int, t: int, block: Mat3) -> None:
    """Set the block (s, t), given by its rows, and its mirror image."""
    for i in range(3):
        for k in range(3):
            jacobian[s, t, i, k] = block[i][k]
            jacobian[t, s, k, i] = block[i][k]


@kernel
def _write_jacobian(hexahedra: Hexahedra, h: int, pressure: float, scratch: HexahedronScratch, matrix: int) -> None:
    """Write the derivative of the forces on the modes by the modes, or its positive semi-definite replacement.

    The latter leaves out how the hourglass forces turn, and of the material what `neo_hookean` leaves out.
    """
    jacobian, modes, inverse, stress = scratch.jacobian, scratch.modes, scratch.inverse, scratch.stress
    numbers, volume = hexahedra.stabilisation_n_m[h], hexahedra.volume_m3[h]
    mu, lam = hexahedra.mu_pa[h], hexahedra.lambda_pa[h]
    c = (load(modes, 0), load(modes, 1), load(modes, 2))
    q = (load(modes, 3), load(modes, 4), load(modes, 5), load(modes, 6))
    g = (load(inverse, 0), load(inverse, 1), load(inverse, 2))
    is_exact = matrix != PROJECTED_MATRIX
    kept = -pressure if is_exact else -0.5 * pressure
    for k in range(COLUMNS):
        block = identity_and_outers(volume * mu, volume * lam, g[k], g[k], volume * kept)
        for m in range(HOURGLASS_VECTORS):
            block = _plus_outer(block, numbers[3 * m + k], q[m], q[m])
        if not is_exact:
            for j in range(COLUMNS):
                block = _plus_outer(block, 0.5 * volume * abs(pressure), g[j], g[j])
        _set_both(jacobian, k, k, block)
        for j in range(k):
            bending, twisting = numbers[12 + _pair(k, j)], numbers[15 + _pair(k, j)]
            # Q_ij = c_j . q_i acts with Q_ji = c_i . q_j, and Q_ii with Q_jj.
            block = _plus_outer(outer(scale(volume * lam, g[k]), g[j]), volume * kept, g[j], g[k])
            block = _plus_outer(_plus_outer(block, twisting, q[k], q[j]), bending, q[j], q[k])
            _set_both(jacobian, k, j, block)
            block = _plus_outer(outer(scale(twisting, c[k]), c[j]), bending, c[j], c[k])
            _set_both(jacobian, COLUMNS + k, COLUMNS + j, block)
    for m in range(HOURGLASS_VECTORS):
        own = outer(scale(numbers[3 * m], c[0]), c[0])
        own = _plus_outer(own, numbers[3 * m + 1], c[1], c[1])
        _set_both(jacobian, COLUMNS + m, COLUMNS + m, _plus_outer(own, numbers[3 * m + 2], c[2], c[2]))
        for k in range(COLUMNS):
            block = outer(scale(numbers[3 * m + k], c[k]), q[m])
            if m < COLUMNS and m != k:
                block = _plus_outer(block, numbers[15 + _pair(m, k)], c[m], q[k])
            elif m == k:
                for j in range(COLUMNS):
                    if j != k:
                        block = _plus_outer(block, numbers[12 + _pair(j, k)], c[j], q[j])
            if is_exact:
                block = _plus_diagonal(block, stress[m, k])
            _set_both(jacobian, COLUMNS + m, k, block)
    if hexahedra.viscous_pa[h] > 0.0:
        _add_viscous_jacobian(volume * hexahedra.viscous_pa[h], c, scratch, matrix)
    if hexahedra.yeoh_pa[h, 0] != 0.0 or hexahedra.yeoh_pa[h, 1] != 0.0:
        first, second = yeoh_slopes(c, hexahedra.yeoh_pa[h, 0], hexahedra.yeoh_pa[h, 1])
        if not is_exact:
            first, second = max(first, 0.0), max(second, 0.0)
        _add_yeoh_jacobian(2.0 * volume * first, 4.0 * volume * second, c, jacobian)


@kernel
def _write_blocks(hexahedra: Hexahedra, h: int, scratch: HexahedronScratch) -> None:
    """Write the blocks of the unknown nodes by all, eight of them at once."""
    jacobian, rows, block, weights = scratch.jacobian, scratch.rows, scratch.block, hexahedra.weights
    w = weight_place(h, 0, 0)
    groups = (w, w + NODES, w + 2 * NODES, w + 3 * NODES, w + 4 * NODES, w + 5 * NODES, w + 6 * NODES)
    for s in range(MODES):
        for i in range(3):
            for k in range(3):
                by = (
                    jacobian[s, 0, i, k], jacobian[s, 1, i, k], jacobian[s, 2, i, k], jacobian[s, 3, i, k],
                    jacobian[s, 4, i, k], jacobian[s, 5, i, k], jacobian[s, 6, i, k],
                )  # fmt: skip
                write_sum_of_seven(rows, NODES * (9 * s + 3 * i + k), by, weights, groups)
    stride = 9 * NODES
    for a in range(NODES):
        if hexahedra.places[h, NODES * a + a] < 0:
            continue
        of = (
            weights[w + a], weights[w + NODES + a], weights[w + 2 * NODES + a], weights[w + 3 * NODES + a],
            weights[w + 4 * NODES + a], weights[w + 5 * NODES + a], weights[w + 6 * NODES + a],
        )  # fmt: skip
        for entry in range(9):
            at = NODES * entry
            places = (
                at,
                at + stride,
                at + 2 * stride,
                at + 3 * stride,
                at + 4 * stride,
                at + 5 * stride,
                at + 6 * stride,
            )
            write_sum_of_seven(block, NODES * (9 * a + entry), of, rows, places)


@kernel
def _add_blocks(hexahedra: Hexahedra, h: int, block: FloatArray, system: NewtonSystem) -> None:
    """Add the blocks of the unknown nodes to the matrix, or to the coupling where the second one is prescribed."""
    for a in range(NODES):
        if hexahedra.places[h, NODES * a + a] < 0:
            continue
        for b in range(NODES):
            place = hexahedra.places[h, NODES * a + b]
            if place >= 0:
                add_block(system.entries, place, GEL_STRIDE, _get_block(block, a, b))
            elif system.moves[0]:
                move = load(system.prescribed_move, hexahedra.nodes[h, b])
                add_to_row(system.coupling, hexahedra.nodes[h, a], apply_rows(_get_block(block, a, b), move))


@kernel
def _get_block(block: FloatArray, a: int, b: int) -> Mat3:
    at = 9 * NODES * a + b
    return (
        (block[at], block[at + 8], block[at + 16]),
        (block[at + 24], block[at + 32], block[at + 40]),
        (block[at + 48], block[at + 56], block[at + 64]),
    )
