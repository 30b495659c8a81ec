"""How a linear tetrahedron deforms: F = sum_a x_a (dN_a/dX)^T, whatever it is made of."""

from ...compilation import kernel
from ..algebra.mat3 import Mat3
from ..algebra.vec3 import Vec3, combine, cross, dot, subtract

# One vector for each of the four corners.
Corners = tuple[Vec3, Vec3, Vec3, Vec3]


@kernel
def deformation_gradient(x: Corners, dN_dX: Corners) -> Mat3:
    """Return the columns of F of a tetrahedron with corners x [m] and rest gradients of the shape functions [1/m].

    The gradient of corner 0 is taken to be minus the sum of the others.
    """
    u, v, w = subtract(x[1], x[0]), subtract(x[2], x[0]), subtract(x[3], x[0])
    g1, g2, g3 = dN_dX[1], dN_dX[2], dN_dX[3]
    return (
        combine(g1[0], u, g2[0], v, g3[0], w),
        combine(g1[1], u, g2[1], v, g3[1], w),
        combine(g1[2], u, g2[2], v, g3[2], w),
    )


@kernel
def cofactors(F: Mat3) -> tuple[Mat3, float]:
    """Return the columns of the cofactor matrix of F (J F^-T), and J = det F."""
    c0 = cross(F[1], F[2])
    return (c0, cross(F[2], F[0]), cross(F[0], F[1])), dot(F[0], c0)
