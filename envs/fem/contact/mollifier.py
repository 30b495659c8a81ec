"""The mollifier that fades out nearly parallel edge pairs.

    e(c) = -(c / eps)^2 + 2 c / eps  for c < eps, else 1,      c = |u x v|^2,   eps = 1e-3 |u_rest|^2 |v_rest|^2

u, v are the edge vectors. Li et al., Incremental Potential Contact (ACM TOG 2020), equation 24.
"""

from ...compilation import kernel
from ..algebra.mat3 import Mat3, identity_and_outer, identity_and_outers
from ..algebra.vec3 import Vec3, cross, dot, scale, subtract


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
