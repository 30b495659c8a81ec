"""Eight numbers at once give what one after the other does, to the last bit, and leave the others alone."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from vitac.envs.compilation import kernel
from vitac.envs.fem.algebra import LANES, add_sum_of_two, subtract_products, write_sum_of_three

FloatArray = NDArray[np.float64]
Three = tuple[float, float, float]


@kernel
def subtract(front: FloatArray, places: tuple[int, int, int, int], factors: tuple[Three, Three, Three]) -> None:
    subtract_products(front, places, factors)  # type: ignore[call-arg]


@pytest.mark.parametrize("skipped", range(LANES))
def test_products_are_subtracted_from_three_rows(skipped: int) -> None:
    random, stride = np.random.default_rng(skipped), 19
    front = random.normal(size=7 * stride)
    f = random.normal(size=(3, 3))
    expected = front.copy()
    rows: Any = expected.reshape(7, stride)
    columns = slice(5 + skipped, 5 + LANES)
    u = rows[0:3, columns].copy()
    for i in range(3):
        rows[3 + i, columns] -= f[i, 0] * u[0] + f[i, 1] * u[1] + f[i, 2] * u[2]
    f0, f1, f2 = ((float(a), float(b), float(c)) for a, b, c in f)
    subtract(front, (3 * stride + 5, 5, stride, skipped), (f0, f1, f2))
    np.testing.assert_array_equal(front, expected)


@kernel
def sum_up(target: FloatArray, source: FloatArray) -> None:
    write_sum_of_three(target, 3, (0.3, 0.7, -1.1), source, (1, 9, 20))
    add_sum_of_two(target, 3, (1.7, 0.1), source, (2, 0))


def test_sums_are_taken_from_left_to_right() -> None:
    target, source = np.zeros(14), np.random.default_rng(0).normal(size=30)
    sum_up(target, source)
    first = 0.3 * source[1:9] + 0.7 * source[9:17] + -1.1 * source[20:28]
    np.testing.assert_array_equal(target, np.pad(first + (1.7 * source[2:10] + 0.1 * source[:8]), 3))
