"""Arithmetic on eight neighbouring numbers at once, for rows too short for the compiler's own vectors.

Before a loop LLVM looks whether any two of its rows overlap, and does what does not fill a vector one by one; for the
rows of a small front that takes as long as the arithmetic. The operations are the same ones in the same order, each
rounded by itself, on every CPU.
"""

from typing import Any

import numba
from llvmlite import ir  # type: ignore[import-untyped]

LANES = 8
_EIGHT_NUMBERS = ir.VectorType(ir.DoubleType(), LANES)
_EIGHT_COUNTS = ir.VectorType(ir.IntType(64), LANES)
_ROWS = 3


@numba.extending.intrinsic
def subtract_products(typing_context, front, places, factors):  # type: ignore[no-untyped-def]  # noqa: ARG001 - numba's intrinsic protocol
    """Subtract from three rows their multiples of three pivot rows, in eight columns but the first few.

    `places` are (row, pivot, stride, skipped), with rows `stride` apart, `factors` (f_0, f_1, f_2):

    front[row + i stride + j] -= f_i[0] front[pivot + j] + f_i[1] front[pivot + stride + j]
                                 + f_i[2] front[pivot + 2 stride + j]    for skipped <= j < 8

    All eight columns of every row have to be there, and nothing between the numbers of a row.
    """
    _check_arrays(front)

    def codegen(context, builder, signature, arguments):  # type: ignore[no-untyped-def]
        data = _get_numbers(context, builder, signature, arguments, 0)
        row, pivot, stride, skipped = (builder.extract_value(arguments[1], k) for k in range(4))

        def lanes(first: Any, i: int) -> Any:
            return _lanes(builder, data, builder.add(first, builder.mul(stride, stride.type(i))))

        here = builder.icmp_signed(">=", _EIGHT_COUNTS(list(range(LANES))), _in_all_lanes(builder, skipped))
        pivots = [builder.load(lanes(pivot, i), align=8) for i in range(_ROWS)]
        for i in range(_ROWS):
            multipliers = [builder.extract_value(arguments[2], (i, k)) for k in range(_ROWS)]
            lanes_of = [_in_all_lanes(builder, multiplier) for multiplier in multipliers]
            products = [builder.fmul(factor, numbers) for factor, numbers in zip(lanes_of, pivots, strict=True)]
            total = builder.fadd(builder.fadd(products[0], products[1]), products[2])
            before = builder.load(lanes(row, i), align=8)
            after = builder.select(here, builder.fsub(before, total), before)
            builder.store(after, lanes(row, i), align=8)
        return context.get_dummy_value()

    four_places = numba.types.UniTuple(numba.types.int64, 4)  # type: ignore[no-untyped-call]
    three = numba.types.UniTuple(numba.types.float64, _ROWS)  # type: ignore[no-untyped-call]
    three_rows = numba.types.UniTuple(three, _ROWS)  # type: ignore[no-untyped-call]
    return numba.types.void(front, four_places, three_rows), codegen


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
