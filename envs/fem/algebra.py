"""Vectors, matrices and rows of numbers for the kernels: small tuples that Numba keeps in registers."""

from typing import Any

import numba
import numpy as np
from llvmlite import ir  # type: ignore[import-untyped]
from numpy.typing import NDArray

from ..compilation import kernel

Vec3 = tuple[float, float, float]


@kernel
def load(rows: NDArray[np.float64], i: int) -> Vec3:
    """Return the row i of an array of shape [n, 3]."""
    return rows[i, 0], rows[i, 1], rows[i, 2]


@kernel
def set_row(rows: NDArray[np.float64], i: int, v: Vec3) -> None:
    """Set row i of an array of shape [n, 3]."""
    rows[i, 0], rows[i, 1], rows[i, 2] = v


@kernel
def add_to_row(rows: NDArray[np.float64], i: int, v: Vec3) -> None:
    """Add a vector to row i of an array of shape [n, 3]."""
    rows[i, 0] += v[0]
    rows[i, 1] += v[1]
    rows[i, 2] += v[2]


@kernel
def add(a: Vec3, b: Vec3) -> Vec3:
    """Sum a + b."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@kernel
def subtract(a: Vec3, b: Vec3) -> Vec3:
    """Return the difference a - b."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@kernel
def scale(s: float, a: Vec3) -> Vec3:
    """Return the product s a."""
    return s * a[0], s * a[1], s * a[2]


@kernel
def dot(a: Vec3, b: Vec3) -> float:
    """Return the scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@kernel
def cross(a: Vec3, b: Vec3) -> Vec3:
    """Return the vector product."""
    return (
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    )


@kernel
def combine(s: float, a: Vec3, t: float, b: Vec3, u: float, c: Vec3) -> Vec3:
    """Return the linear combination s a + t b + u c."""
    return (
        s * a[0] + t * b[0] + u * c[0],
        s * a[1] + t * b[1] + u * c[1],
        s * a[2] + t * b[2] + u * c[2],
    )


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


FloatArray = NDArray[np.float64]


@kernel
def copy_rows(source: FloatArray, target: FloatArray) -> None:
    """Write target = source."""
    for i in range(len(target)):
        for k in range(3):
            target[i, k] = source[i, k]


@kernel
def scale_rows(s: float, rows: FloatArray) -> None:
    """Write rows = s rows."""
    for i in range(len(rows)):
        for k in range(3):
            rows[i, k] = s * rows[i, k]


@kernel
def add_rows(a: FloatArray, s: float, b: FloatArray, target: FloatArray) -> None:
    """Write target = a + s b; the target may be a or b."""
    for i in range(len(target)):
        for k in range(3):
            target[i, k] = a[i, k] + s * b[i, k]


@kernel
def any_nonzero(rows: FloatArray) -> bool:
    """Return whether any component is not zero."""
    for i in range(len(rows)):
        for k in range(3):
            if rows[i, k] != 0.0:
                return True
    return False


LANES = 8
_EIGHT_NUMBERS = ir.VectorType(ir.DoubleType(), LANES)
_EIGHT_COUNTS = ir.VectorType(ir.IntType(64), LANES)
_ROWS = 3


@numba.extending.intrinsic
def subtract_products(typing_context, front, places, factors):  # type: ignore[no-untyped-def]  # noqa: ARG001 - numba's intrinsic protocol
    """Subtract from three rows their multiples of pivot rows, three at a time, in eight columns but the first few.

    `places` are (row, pivot, stride, skipped), with rows `stride` apart, and `factors` (f_0, f_1, f_2) for each three
    pivot rows, which follow each other:

    front[row + i stride + j] -= f_i[0] front[pivot + j] + f_i[1] front[pivot + stride + j]
                                 + f_i[2] front[pivot + 2 stride + j]    for skipped <= j < 8

    All eight columns of every row have to be there, and nothing between the numbers of a row.
    """
    _check_arrays(front)
    groups = len(factors) // _ROWS

    def codegen(context, builder, signature, arguments):  # type: ignore[no-untyped-def]
        data = _get_numbers(context, builder, signature, arguments, 0)
        row, pivot, stride, skipped = (builder.extract_value(arguments[1], k) for k in range(4))

        def lanes(first: Any, i: int) -> Any:
            return _lanes(builder, data, builder.add(first, builder.mul(stride, stride.type(i))))

        here = builder.icmp_signed(">=", _EIGHT_COUNTS(list(range(LANES))), _in_all_lanes(builder, skipped))
        pivots = [builder.load(lanes(pivot, i), align=8) for i in range(_ROWS * groups)]
        for i in range(_ROWS):
            before = after = builder.load(lanes(row, i), align=8)
            for group in range(groups):
                products = [
                    builder.fmul(
                        _in_all_lanes(builder, builder.extract_value(arguments[2], (_ROWS * group + i, k))),
                        pivots[_ROWS * group + k],
                    )
                    for k in range(_ROWS)
                ]
                total = builder.fadd(builder.fadd(products[0], products[1]), products[2])
                after = builder.fsub(after, total)
            builder.store(builder.select(here, after, before), lanes(row, i), align=8)
        return context.get_dummy_value()

    four_places = numba.types.UniTuple(numba.types.int64, 4)  # type: ignore[no-untyped-call]
    three = numba.types.UniTuple(numba.types.float64, _ROWS)  # type: ignore[no-untyped-call]
    multipliers = numba.types.UniTuple(three, _ROWS * groups)  # type: ignore[no-untyped-call]
    return numba.types.void(front, four_places, multipliers), codegen


def _weighted_sum(terms: int, *, adds: bool) -> Any:
    """Return an intrinsic that writes a weighted sum of groups of eight numbers, or adds it to what is there."""

    @numba.extending.intrinsic
    def write(typing_context, target, place, weights, source, groups):  # type: ignore[no-untyped-def]  # noqa: ARG001 - numba's intrinsic protocol
        _check_arrays(target, source)

        def codegen(context, builder, signature, arguments):  # type: ignore[no-untyped-def]
            to = _lanes(builder, _get_numbers(context, builder, signature, arguments, 0), arguments[1])
            numbers = _get_numbers(context, builder, signature, arguments, 3)
            total = None
            for k in range(terms):
                weight = _in_all_lanes(builder, builder.extract_value(arguments[2], k))
                group = _lanes(builder, numbers, builder.extract_value(arguments[4], k))
                product = builder.fmul(weight, builder.load(group, align=8))
                total = product if total is None else builder.fadd(total, product)
            if adds:
                total = builder.fadd(builder.load(to, align=8), total)
            builder.store(total, to, align=8)
            return context.get_dummy_value()

        number, real = numba.types.int64, numba.types.float64
        numbers, reals = numba.types.UniTuple(number, terms), numba.types.UniTuple(real, terms)  # type: ignore[no-untyped-call]
        return numba.types.void(target, number, reals, source, numbers), codegen

    return write


# write(target, place, weights, source, groups): target[place + j] = w_0 source[g_0 + j] + w_1 ... for 0 <= j < 8
write_sum_of_three = _weighted_sum(3, adds=False)
write_sum_of_seven = _weighted_sum(7, adds=False)
add_sum_of_two = _weighted_sum(2, adds=True)


def _check_arrays(*arrays: Any) -> None:
    for array in arrays:
        if (array.dtype, array.ndim, array.layout) != (numba.types.float64, 1, "C"):
            raise numba.errors.TypingError(f"Lanes take contiguous float64 arrays, got {array}.")


def _get_numbers(context: Any, builder: Any, signature: Any, arguments: Any, i: int) -> Any:
    return context.make_array(signature.args[i])(context, builder, arguments[i]).data


def _lanes(builder: Any, data: Any, place: Any) -> Any:
    return builder.bitcast(builder.gep(data, [place]), _EIGHT_NUMBERS.as_pointer())


def _in_all_lanes(builder: Any, value: Any) -> Any:
    vector = ir.VectorType(value.type, LANES)
    nothing, first = ir.Constant(vector, ir.Undefined), ir.VectorType(ir.IntType(32), LANES)([0] * LANES)
    return builder.shuffle_vector(builder.insert_element(nothing, value, ir.IntType(32)(0)), nothing, first)
