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
    """Return three rows less their multiples of three pivot rows, in eight columns but the first few, `stride` apart.

    `places` are (row, pivot, stride, skipped), `factors` (f_0, f_1, f_2):

    front[row + i stride + j] -= f_i[0] front[pivot + j] + f_i[1] front[pivot + stride + j]
                                 + f_i[2] front[pivot + 2 stride + j]    for skipped <= j < 8

    All eight columns of every row have to be there, and nothing between the numbers of a row.
    """
    if (front.dtype, front.ndim, front.layout) != (numba.types.float64, 1, "C"):
        raise numba.errors.TypingError(f"subtract_products takes a contiguous float64 array, got {front}.")

    def codegen(context, builder, signature, arguments):  # type: ignore[no-untyped-def]
        data = context.make_array(signature.args[0])(context, builder, arguments[0]).data
        row, pivot, stride, skipped = (builder.extract_value(arguments[1], k) for k in range(4))

        def lanes(first: Any, i: int) -> Any:
            place = builder.add(first, builder.mul(stride, stride.type(i)))
            return builder.bitcast(builder.gep(data, [place]), _EIGHT_NUMBERS.as_pointer())

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


def _in_all_lanes(builder: Any, value: Any) -> Any:
    vector = ir.VectorType(value.type, LANES)
    nothing, first = ir.Constant(vector, ir.Undefined), ir.VectorType(ir.IntType(32), LANES)([0] * LANES)
    return builder.shuffle_vector(builder.insert_element(nothing, value, ir.IntType(32)(0)), nothing, first)
