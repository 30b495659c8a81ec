"""Smoothed Coulomb friction of one contact.

    D(u) = mu lambda f0(|u|),   f0(y) = -y^3 / (3 s^2) + y^2 / s + s / 3  for y < s, else y        [m]

u is the tangential slip since the beginning of the IPC step [m], lambda [N] the normal force, s = eps_v h [m] the slip
at which the full Coulomb force mu lambda is reached. Li et al., Incremental Potential Contact (ACM TOG 2020),
equations 13-18.

Where s is a few micrometres, Newton's method jumps between sticking and sliding in opposite directions. It does not
where the equation u = phi / a(|u|), a = f1 / |u|, is linearised in place of phi = a u, with a *dual variable* phi of
its own, at most 1 long, that follows u from iteration to iteration (Chan, Golub & Mulet, SIAM J. Sci. Comput. 20, 1999,
for |grad u| of a picture). The forces stay those of u, so the solution is the same; only the matrix differs, by phi / a
in place of one u, until u comes to rest.
"""

import numpy as np
from numpy.typing import NDArray

from ...compilation import kernel
from ..algebra.vec3 import Vec3, add, dot, scale, subtract


@kernel
def slip_potential(y: float, s: float) -> float:
    """Return f0(y) [m], the integral of f1."""
    if y >= s:
        return y
    return y * y * (1.0 - y / (3.0 * s)) / s + s / 3.0


# Length of the dual variable of a contact that had none, as part of the friction force: it may yet stick or slide.
_FIRST_DUAL = 0.75


@kernel
def update_dual(dual: NDArray[np.float64], k: int, u: Vec3, s: float) -> Vec3:
    """Take the dual variable of contact k to the slip u [m]; return phi / a [m], which is u where u has not moved."""
    u_0, phi_0 = (dual[k, 0], dual[k, 1], dual[k, 2]), (dual[k, 3], dual[k, 4], dual[k, 5])
    a, _ = slip_factor(np.sqrt(dot(u, u)), s)
    phi = scale(_FIRST_DUAL * a, u)
    if not np.isnan(u_0[0]):
        a_0, slope_0 = slip_factor(np.sqrt(dot(u_0, u_0)), s)
        turn = slope_0 / a_0 * dot(u_0, subtract(u, u_0))
        phi = add(scale(a_0, u), scale(turn, phi_0))
        size = np.sqrt(dot(phi, phi))
        if size > 1.0:
            phi = scale(1.0 / size, phi)
    dual[k, 0], dual[k, 1], dual[k, 2] = u
    dual[k, 3], dual[k, 4], dual[k, 5] = phi
    return scale(1.0 / a, phi)


@kernel
def slip_factor(y: float, s: float) -> tuple[float, float]:
    """Return f1(y)/y [1/m] and (f1'(y) - f1(y)/y)/y^2 [1/m^3], where f1 = f0' is the fraction of the Coulomb force.

    Both are finite at y = 0: f1/y = 2/s - y/s^2 and f1' - f1/y = -y/s^2 below s; f1 = 1 above. The second is divided by
    y^2 so that it multiplies u u^T; at y = 0 it is replaced by 0, since u u^T vanishes faster.
    """
    if y >= s:
        return 1.0 / y, -1.0 / (y * y * y)
    second = 0.0 if y == 0.0 else -1.0 / (s * s * y)
    return 2.0 / s - y / (s * s), second
