"""Smoothed Coulomb friction of one contact.

    D(u) = mu lambda f0(|u|),   f0(y) = -y^3 / (3 s^2) + y^2 / s + s / 3  for y < s, else y        [m]

u is the tangential slip since the beginning of the IPC step [m], lambda [N] the normal force, s = eps_v h [m] the slip
at which the full Coulomb force mu lambda is reached. Li et al., Incremental Potential Contact (ACM TOG 2020),
equations 13-18.
"""

from ...compilation import kernel


@kernel
def slip_potential(y: float, s: float) -> float:
    """Return f0(y) [m], the integral of f1."""
    if y >= s:
        return y
    return y * y * (1.0 - y / (3.0 * s)) / s + s / 3.0


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
