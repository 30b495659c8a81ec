"""Compressible neo-Hookean elasticity of one linear tetrahedron.

    psi(F) = mu/2 (tr F^T F - 3) - mu ln J + lambda/2 (ln J)^2     [J/m^3],  J = det F

Sifakis & Barbic, FEM Simulation of 3D Deformable Solids (2012), section 3.4. F = sum_a x_a g_a^T, where g_a [1/m] are
the rest gradients of the linear shape functions. With h_a = F^-T g_a the nodal gradient and the Hessian block are

    dE/dx_a       = V ( mu F g_a + (lambda ln J - mu) h_a )
    d2E/dx_a dx_b = V ( mu (g_a . g_b) I + lambda h_a h_b^T + (mu - lambda ln J) h_b h_a^T )
"""

from ...compilation import kernel
from ...deterministic_math import natural_log
from ..algebra.mat3 import Mat3, add_matrices, identity_and_outers, scale_matrix
from ..algebra.vec3 import Vec3, add, combine, cross, dot, scale, subtract


def lame_parameters_pa(youngs_modulus_pa: float, poisson_ratio: float) -> tuple[float, float]:
    """Lame parameters (mu, lambda) [Pa]: mu = E / (2 (1 + nu)), lambda = E nu / ((1 + nu) (1 - 2 nu))."""
    mu = youngs_modulus_pa / (2.0 * (1.0 + poisson_ratio))
    lam = youngs_modulus_pa * poisson_ratio / ((1.0 + poisson_ratio) * (1.0 - 2.0 * poisson_ratio))
    return mu, lam


@kernel
def deformation_gradient(x0: Vec3, x1: Vec3, x2: Vec3, x3: Vec3, g1: Vec3, g2: Vec3, g3: Vec3) -> Mat3:
    """Columns of F of a tetrahedron with corners x [m]; the rest gradient of corner 0 is -(g1 + g2 + g3) [1/m]."""
    u, v, w = subtract(x1, x0), subtract(x2, x0), subtract(x3, x0)
    return (
        combine(g1[0], u, g2[0], v, g3[0], w),
        combine(g1[1], u, g2[1], v, g3[1], w),
        combine(g1[2], u, g2[2], v, g3[2], w),
    )


@kernel
def cofactors(F: Mat3) -> tuple[Mat3, float]:
    """Columns of the cofactor matrix of F (J F^-T), and J = det F."""
    c0 = cross(F[1], F[2])
    return (c0, cross(F[2], F[0]), cross(F[0], F[1])), dot(F[0], c0)


@kernel
def strain_energy_density(F: Mat3, J: float, mu: float, lam: float) -> float:
    """psi(F) [J/m^3]; J = det F must be positive."""
    log_j = natural_log(J)
    squared_norm = dot(F[0], F[0]) + dot(F[1], F[1]) + dot(F[2], F[2])
    return 0.5 * mu * (squared_norm - 3.0) - mu * log_j + 0.5 * lam * log_j * log_j


@kernel
def nodal_gradient(volume: float, mu: float, pressure: float, Fg: Vec3, h: Vec3) -> Vec3:
    """dE/dx_a [N] from F g_a, h_a = F^-T g_a and pressure = lambda ln J - mu [Pa]."""
    return add(scale(volume * mu, Fg), scale(volume * pressure, h))


@kernel
def stiffness_block(volume: float, mu: float, lam: float, pressure: float, gg: float, ha: Vec3, hb: Vec3) -> Mat3:
    """Rows of d2E/dx_a dx_b [N/m]; gg = g_a . g_b [1/m^2], pressure = lambda ln J - mu [Pa]."""
    return identity_and_outers(volume * mu * gg, volume * lam, ha, hb, -volume * pressure)


@kernel
def projected_stiffness_block(
    volume: float,
    mu: float,
    lam: float,
    pressure: float,
    gg: float,
    ha: Vec3,
    hb: Vec3,
    inverse_b: Mat3,
) -> Mat3:
    """Rows of a positive semi-definite replacement of `stiffness_block`; inverse_b = (F F^T)^-1.

    Only the last term of the Hessian is indefinite: with M = F^-1 dF it is q tr(M M) = q |sym M|^2 - q |skew M|^2,
    q = mu - lambda ln J. The part of the wrong sign is left out: q |sym M|^2 is kept for q > 0, |q| |skew M|^2 for
    q < 0, where |sym M|^2 = (|M|^2 + tr M M) / 2 and |skew M|^2 = (|M|^2 - tr M M) / 2.
    """
    q = -volume * pressure
    block = stiffness_block(volume, mu, lam, -0.5 * q / volume, gg, ha, hb)
    s = 0.5 * abs(q) * gg
    return add_matrices(block, scale_matrix(s, inverse_b))
