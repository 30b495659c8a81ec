"""3 x 3 matrices as tuples of three vectors, which Numba keeps in registers.

Whether the vectors are a matrix's rows or its columns is said where it matters.
"""

from ...compilation import kernel
from .vec3 import Vec3, add, combine, dot, scale

Mat3 = tuple[Vec3, Vec3, Vec3]


@kernel
def add_matrices(a: Mat3, b: Mat3) -> Mat3:
    """Sum A + B."""
    return add(a[0], b[0]), add(a[1], b[1]), add(a[2], b[2])


@kernel
def scale_matrix(s: float, a: Mat3) -> Mat3:
    """Return the product s A."""
    return scale(s, a[0]), scale(s, a[1]), scale(s, a[2])


@kernel
def transpose(a: Mat3) -> Mat3:
    """Return the rows of a matrix given by its columns, and the other way round."""
    x, y, z = a
    return (x[0], y[0], z[0]), (x[1], y[1], z[1]), (x[2], y[2], z[2])


@kernel
def apply_rows(rows: Mat3, v: Vec3) -> Vec3:
    """Return the matrix, given by its rows, times vector."""
    return dot(rows[0], v), dot(rows[1], v), dot(rows[2], v)


@kernel
def apply_columns(columns: Mat3, v: Vec3) -> Vec3:
    """Return the matrix, given by its columns, times vector."""
    return combine(v[0], columns[0], v[1], columns[1], v[2], columns[2])


@kernel
def multiply_rows(a: Mat3, b: Mat3) -> Mat3:
    """Return the rows of A B, of matrices given by their rows."""
    return apply_columns(b, a[0]), apply_columns(b, a[1]), apply_columns(b, a[2])


@kernel
def outer(a: Vec3, b: Vec3) -> Mat3:
    """Return the rows of a b^T."""
    return scale(a[0], b), scale(a[1], b), scale(a[2], b)


@kernel
def outer_square(columns: Mat3) -> Mat3:
    """Return the rows of A A^T, of a matrix given by its columns."""
    a, b, c = columns
    return add_matrices(add_matrices(outer(a, a), outer(b, b)), outer(c, c))


@kernel
def identity_and_outer(s: float, t: float, a: Vec3) -> Mat3:
    """Return the rows of s I + t a a^T."""
    return identity_and_outers(s, t, a, a, 0.0)


@kernel
def identity_and_outers(s: float, p: float, a: Vec3, b: Vec3, q: float) -> Mat3:
    """Return the rows of s I + p a b^T + q b a^T."""
    return (
        (
            s + p * a[0] * b[0] + q * b[0] * a[0],
            p * a[0] * b[1] + q * b[0] * a[1],
            p * a[0] * b[2] + q * b[0] * a[2],
        ),
        (
            p * a[1] * b[0] + q * b[1] * a[0],
            s + p * a[1] * b[1] + q * b[1] * a[1],
            p * a[1] * b[2] + q * b[1] * a[2],
        ),
        (
            p * a[2] * b[0] + q * b[2] * a[0],
            p * a[2] * b[1] + q * b[2] * a[1],
            s + p * a[2] * b[2] + q * b[2] * a[2],
        ),
    )
