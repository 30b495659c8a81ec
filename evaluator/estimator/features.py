"""What the standard estimator reads from a marker flow: a smooth field of motion for each sensor."""

import numpy as np
from numpy.typing import NDArray

from .least_squares import normal_equations, solve

# Half the picture, by which positions are scaled.
_HALF_U_PX, _HALF_V_PX = 160.0, 120.0
# Keeps the field defined where few markers are seen, or all on one line.
_RIDGE = 0.1
_TERMS = 6
COUNT = 2 * 2 * _TERMS
"""Two sensors, two directions, six terms."""


def compute_features(marker_flow: NDArray[np.float32], *, at_rest: bool = False) -> list[float]:
    """Return the coefficients of the motion of the markers in both pictures [pixel].

    In each picture, motion is fitted by the terms 1, x, y, x^2, x y, y^2 of the reference position, which is 0 in the
    middle and 1 at the rim; first all terms of u, then of v; first the left sensor.

    Args:
        marker_flow: shape [2, 2, m, 2] [pixel]; the last marker may be repeated to fill it.
        at_rest: all markers are where they were in the reference.
    """
    if at_rest:
        return [0.0] * COUNT
    return [value for flow in marker_flow.astype(np.float64) for value in _field(*_distinct(flow))]


def _distinct(flow: NDArray[np.float64]) -> tuple[list[list[float]], list[list[float]]]:
    """Return reference and current positions without the repeats of the last marker."""
    repeats = (flow == flow[:, -1:]).all(axis=(0, 2))
    count = int(repeats.argmax()) + 1
    reference, current = flow[:, :count].tolist()
    return reference, current


def _field(reference: list[list[float]], current: list[list[float]]) -> list[float]:
    rows, motions = [], []
    for (u, v), (u_now, v_now) in zip(reference, current, strict=True):
        x, y = (u - _HALF_U_PX) / _HALF_U_PX, (v - _HALF_V_PX) / _HALF_V_PX
        rows.append((1.0, x, y, x * x, x * y, y * y))
        motions.append((u_now - u, v_now - v))
    squares, products = normal_equations(rows, motions)
    for term in range(_TERMS):
        squares[term][term] += _RIDGE
    found = solve(squares, products)
    return [row[direction] for direction in range(2) for row in found]
