"""Barrier, laws of friction and mollifier of one contact."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...compilation import kernel
from ...deterministic_math import natural_log
from ..algebra import Mat3, Vec3, add, cross, dot, identity_and_outer, identity_and_outers, scale, subtract


@kernel
def barrier(d: float, d_hat: float) -> tuple[float, float, float]:
    """Return B [m^2], b' [m] (negative) and b'' [-] (positive) at 0 < d < d_hat [m]."""
    gap = d - d_hat
    log_ratio = natural_log(d / d_hat)
    ratio = gap / d
    value = -gap * gap * log_ratio
    first = -gap * (2.0 * log_ratio + ratio)
    second = -2.0 * log_ratio - 4.0 * ratio + ratio * ratio
    return value, first, second


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
    """Take the dual variable of contact k to the slip u [m]; return phi / a [m], which is u where u has not moved.

    The fraction of the Coulomb force is that of `yield_factor`, with the slip s [m].
    """
    u_0, phi_0 = (dual[k, 0], dual[k, 1], dual[k, 2]), (dual[k, 3], dual[k, 4], dual[k, 5])
    a, _ = yield_factor(np.sqrt(dot(u, u)), s)
    phi = scale(_FIRST_DUAL * a, u)
    if not np.isnan(u_0[0]):
        a_0, slope_0 = yield_factor(np.sqrt(dot(u_0, u_0)), s)
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


# Part of the Coulomb force by which the corner between sticking and sliding is rounded off.
_ROUNDED = 0.002
YIELDED = 1.0 + _ROUNDED


@kernel
def yield_factor(y: float, s: float) -> tuple[float, float]:
    """Return the same as `slip_factor` for a spring that yields at the slip s: f1 = y/s below it, and 1 above.

    In z = y/s the corner is rounded off by a parabola from 1 - _ROUNDED to 1 + _ROUNDED.
    """
    z = y / s
    if z <= 1.0 - _ROUNDED:
        return 1.0 / s, 0.0
    if z >= 1.0 + _ROUNDED:
        return 1.0 / y, -1.0 / (y * y * y)
    past = z - 1.0 + _ROUNDED
    fraction, slope = z - past * past / (4.0 * _ROUNDED), 1.0 - past / (2.0 * _ROUNDED)
    return fraction / y, (slope / s - fraction / y) / (y * y)


class Drag(NamedTuple):
    """Friction phi = A u of a slip u [m], and how it changes."""

    a_n_m: float  # A [N/m]
    slope_n_m3: float  # (d(A y)/dy - A) / y^2 at y = |u|
    by_normal_force_1_m: float  # dA/dN


@kernel
def drag(y: float, force_n: float, coefficient: float, s: float, stiffness_n_m: float) -> Drag:
    """Return the friction of a slip of length y [m] under a normal force [N], which is negative where it is taken away.

    Without a stiffness it develops over the slip s [m], whatever the force. With one [N/m] it is a spring that yields
    at the Coulomb force, mu N: what is loaded at one normal force is not more at another one, so that no closed cycle
    yields energy (Elata & Berryman, Mechanics of Materials 24, 1996).
    """
    coulomb = coefficient * force_n
    if stiffness_n_m == 0.0:
        a, slope = slip_factor(y, s)
        return Drag(coulomb * a, coulomb * slope, coefficient * a)
    s = abs(coulomb) / stiffness_n_m
    if s == 0.0:
        return Drag(0.0, 0.0, 0.0)
    a, slope = yield_factor(y, s)
    # f1 depends on y/s, and s is proportional to N: N df1/dN = -y df1/dy.
    return Drag(coulomb * a, coulomb * slope, -coefficient * y * y * slope)


@kernel
def squared_cross_norm(u: Vec3, v: Vec3) -> float:
    """Return C = |u x v|^2 [m^4]."""
    w = cross(u, v)
    return dot(w, w)


@kernel
def mollifier(c: float, eps: float) -> tuple[float, float, float]:
    """Return E [-], de/dc and d2e/dc2; exactly (1, 0, 0) from c = eps on."""
    if c >= eps:
        return 1.0, 0.0, 0.0
    ratio = c / eps
    return ratio * (2.0 - ratio), 2.0 * (1.0 - ratio) / eps, -2.0 / (eps * eps)


@kernel
def squared_cross_norm_gradient(u: Vec3, v: Vec3) -> tuple[Vec3, Vec3]:
    """Return (dc/du, dc/dv) [m^3]: dc/du = 2 (|v|^2 u - (u . v) v), and the same with u and v exchanged."""
    uv = dot(u, v)
    return (
        scale(2.0, subtract(scale(dot(v, v), u), scale(uv, v))),
        scale(2.0, subtract(scale(dot(u, u), v), scale(uv, u))),
    )


@kernel
def squared_cross_norm_blocks(u: Vec3, v: Vec3) -> tuple[Mat3, Mat3, Mat3]:
    """Return the rows of d2c/du du, d2c/du dv and d2c/dv dv [m^2].

    They are 2 (|v|^2 I - v v^T), 4 u v^T - 2 v u^T - 2 (u . v) I and 2 (|u|^2 I - u u^T).
    """
    uu, vv, uv = dot(u, u), dot(v, v), dot(u, v)
    return (
        identity_and_outer(2.0 * vv, -2.0, v),
        identity_and_outers(-2.0 * uv, 4.0, u, v, -2.0),
        identity_and_outer(2.0 * uu, -2.0, u),
    )
