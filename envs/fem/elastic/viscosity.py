"""Viscosity of hexahedral gels: a Prony series of branches beside the elasticity, whose strain follows the gel's.

With Green's strain E = (F^T F - I) / 2, which turns do not change, branch i of modulus G_i [Pa] and relaxation time
tau_i [s] relaxes as d e_i / dt = (dev E - e_i) / tau_i from its strain e_i. An implicit step of length h gives the
stress 2 G_i (dev E - e_i) with the new e_i, which is that of the energy

    V G_i / (1 + h / tau_i) |dev E - e_i|^2     with the e_i of the start                                           [J]

so that the branch never gives more than was put into it (Simo & Hughes, Computational Inelasticity, 1998, section 10).
Shear relaxes, volume does not, and the stabilisation of hourglasses stays elastic.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...compilation import kernel, large_kernel
from ..algebra import Mat3, dot
from ..model.mesh import GelBody
from ..model.model import Hexahedra, get_mode
from .neo_hookean import lame_parameters_pa

FloatArray = NDArray[np.float64]
# Components (0, 0), (1, 1), (2, 2), (0, 1), (0, 2) and (1, 2) of a symmetric matrix.
Sym3 = tuple[float, float, float, float, float, float]


class Branches(NamedTuple):
    """The branches of all hexahedra; a gel with fewer than another one has some without modulus."""

    modulus_pa: FloatArray  # [b, c] G / (1 + h / tau)
    rate: FloatArray  # [b, c] h / tau


def build_branches(gels: Sequence[GelBody], time_step_s: float) -> Branches:
    """Return the branches of gels for IPC steps of this length [s]."""
    counts = [len(gel.mesh.hexahedra) for gel in gels]
    modulus_pa, rate = np.zeros((2, max(len(gel.viscosity) for gel in gels), len(gels)))
    for g, gel in enumerate(gels):
        mu_pa, _ = lame_parameters_pa(gel.youngs_modulus_pa, gel.poisson_ratio)
        for b, branch in enumerate(gel.viscosity):
            rate[b, g] = time_step_s / branch.relaxation_time_s
            modulus_pa[b, g] = branch.modulus_ratio * mu_pa / (1.0 + rate[b, g])
    return Branches(np.repeat(modulus_pa, counts, axis=1), np.repeat(rate, counts, axis=1))


def held_stress_pa(branches: Branches, strain: FloatArray) -> FloatArray:
    """Return sum_i G_i / (1 + h / tau_i) e_i [Pa], shape [c, 6], of the branches' strains, shape [b, c, 6]."""
    total = np.zeros(strain.shape[1:])
    for modulus_pa, own in zip(branches.modulus_pa, strain, strict=True):
        total += modulus_pa[:, None] * own
    return total


def follow_strain(branches: Branches, strain: FloatArray, hexahedra: Hexahedra, x: FloatArray) -> FloatArray:
    """Return the branches' strains, shape [b, c, 6], at the end of a step that leads to nodes x [m], shape [n, 3]."""
    now = np.empty(strain.shape[1:])
    write_deviators(hexahedra, x, now)
    rate = branches.rate[:, :, None]
    return np.asarray((strain + rate * now) / (1.0 + rate))


@large_kernel
def write_deviators(hexahedra: Hexahedra, x: FloatArray, deviators: FloatArray) -> None:
    """Write dev E of all hexahedra, shape [c, 6], at nodes x [m]."""
    for h in range(len(hexahedra.volume_m3)):
        F = get_mode(hexahedra, h, 0, x), get_mode(hexahedra, h, 1, x), get_mode(hexahedra, h, 2, x)
        e = deviator(F)
        for k in range(6):
            deviators[h, k] = e[k]


@kernel
def deviator(F: Mat3) -> Sym3:
    """Return dev E of the columns of F."""
    s0, s1, s2 = dot(F[0], F[0]), dot(F[1], F[1]), dot(F[2], F[2])
    mean = (s0 + s1 + s2) / 3.0
    return (
        0.5 * (s0 - mean),
        0.5 * (s1 - mean),
        0.5 * (s2 - mean),
        0.5 * dot(F[0], F[1]),
        0.5 * dot(F[0], F[2]),
        0.5 * dot(F[1], F[2]),
    )
