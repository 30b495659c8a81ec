"""Disparity between two rectified pictures: census, block costs and semi-global matching, all in whole numbers.

Hirschmuller, Stereo Processing by Semiglobal Matching and Mutual Information (2008); census: Zabih & Woodfill (1994).
The left picture is compared with a right one whose column i + e lies `LARGEST_DISPARITY - e` to the left of column i:
e, the match's index, counts disparities downwards.
"""

import numba
import numpy as np
from numpy.typing import NDArray

from ...compilation import kernel, large_kernel
from .method import METHOD

Picture = NDArray[np.uint8]
Codes = NDArray[np.uint64]
# Cost of every pixel and match, shape [height, width, matches].
Costs = NDArray[np.int16]

SMALLEST_DISPARITY = METHOD.smallest_disparity_px
LARGEST_DISPARITY = METHOD.largest_disparity_px
MATCHES = LARGEST_DISPARITY - SMALLEST_DISPARITY + 1
# A disparity is given in this many parts of a pixel.
PARTS = 64
NO_DISPARITY = 0

_CENSUS_RADIUS = METHOD.census_radius_px
_BLOCK_RADIUS = METHOD.block_radius_px
_BLOCK_PIXELS = (2 * _BLOCK_RADIUS + 1) ** 2
_SMALL_JUMP = np.int16(METHOD.small_jump * _BLOCK_PIXELS)
_LARGE_JUMP = np.int16(METHOD.large_jump * _BLOCK_PIXELS)
# Larger than any path's cost; with a jump added it still is an int16.
_FAR = np.int16(16000)
_PATHS = ((0, 1), (0, -1), (1, 0), (-1, 0), (1, 1), (1, -1), (-1, 1), (-1, -1))[: METHOD.paths]
_UNIQUENESS_PERCENT = METHOD.uniqueness_percent
_LARGEST_LEFT_RIGHT_DIFFERENCE = METHOD.largest_left_right_difference_px


def disparities(left: Picture, right: Picture) -> NDArray[np.int32]:
    """Return the disparity of every pixel of the left picture in parts of a pixel, 0 where there is no match.

    Args:
        left: grey levels, shape [height, width], C-contiguous like the right one.
        right: grey levels, shape [height, width + MATCHES - 1]; its first column lies `LARGEST_DISPARITY` to the left
            of the left picture's.
    """
    height, width = left.shape
    left_codes, right_codes = np.zeros(left.shape, np.uint64), np.zeros(right.shape, np.uint64)
    _census(left, left_codes)
    _census(right, right_codes)
    costs, blocks = (np.zeros((height, width, MATCHES), np.int16) for _ in range(2))
    _compare(left_codes, right_codes, costs)
    _sum_blocks(costs, blocks)
    totals = np.zeros((height, width, MATCHES), np.int16)
    lines = np.zeros((2, width + 2, MATCHES + 2), np.int16)
    for row_step, column_step in _PATHS:
        _add_path(blocks, lines, totals, row_step, column_step)
    best_of_right = np.zeros((height, width + MATCHES - 1), np.int32)
    found = np.zeros(left.shape, np.int32)
    _choose(totals, best_of_right, found)
    return found


@numba.extending.intrinsic
def _count_ones(typing_context, bits):  # type: ignore[no-untyped-def]  # noqa: ARG001 - numba's intrinsic protocol
    def codegen(context, builder, signature, arguments):  # type: ignore[no-untyped-def]  # noqa: ARG001
        return builder.ctpop(arguments[0])

    return numba.types.uint64(numba.types.uint64), codegen


@large_kernel
def _census(picture: Picture, codes: Codes) -> None:
    """Set a bit for every neighbour that is darker than its pixel; neighbours beyond the picture set none."""
    height, width = picture.shape
    r = _CENSUS_RADIUS
    for dj in range(-r, r + 1):
        for di in range(-r, r + 1):
            if dj == 0 and di == 0:
                continue
            for j in range(max(0, -dj), min(height, height - dj)):
                for i in range(max(0, -di), min(width, width - di)):
                    darker = np.uint64(picture[j + dj, i + di] < picture[j, i])
                    codes[j, i] = (codes[j, i] << np.uint64(1)) | darker


@large_kernel
def _compare(left: Codes, right: Codes, costs: Costs) -> None:
    """Count the census bits in which a pixel and its match differ."""
    height, width, matches = costs.shape
    for j in range(height):
        for i in range(width):
            for e in range(matches):
                costs[j, i, e] = _count_ones(left[j, i] ^ right[j, i + e])  # type: ignore[call-arg]


@large_kernel
def _sum_blocks(costs: Costs, blocks: Costs) -> None:
    """Sum the costs over the block around every pixel; first along columns, into `blocks`, then along rows."""
    height, width, matches = costs.shape
    r = _BLOCK_RADIUS
    for j in range(height):
        for k in range(max(0, j - r), min(height, j + r + 1)):
            for i in range(width):
                for e in range(matches):
                    blocks[j, i, e] += costs[k, i, e]
    for j in range(height):
        for i in range(width):
            for e in range(matches):
                costs[j, i, e] = blocks[j, i, e]
                blocks[j, i, e] = 0
        for i in range(width):
            for k in range(max(0, i - r), min(width, i + r + 1)):
                for e in range(matches):
                    blocks[j, i, e] += costs[j, k, e]


@large_kernel
def _add_path(costs: Costs, lines: Costs, totals: Costs, row_step: int, column_step: int) -> None:
    """Add to the totals the costs of the cheapest paths that reach each pixel in one direction (eq. 13).

    `lines` holds the path costs of the row before and of this one, with a border of columns that cost nothing.
    """
    height, width, matches = costs.shape
    lines[:, :, :] = 0
    lines[:, 1 : width + 1, 0] = _FAR
    lines[:, 1 : width + 1, matches + 1] = _FAR
    for jj in range(height):
        j = jj if row_step >= 0 else height - 1 - jj
        now = jj % 2
        before = now if row_step == 0 else 1 - now
        for ii in range(width):
            i = ii if column_step >= 0 else width - 1 - ii
            p = i + 1 - column_step
            smallest = _FAR
            for e in range(1, matches + 1):
                smallest = min(smallest, lines[before, p, e])
            jump = np.int16(smallest + _LARGE_JUMP)
            for e in range(matches):
                cheapest = min(lines[before, p, e + 1], jump)
                cheapest = min(cheapest, np.int16(lines[before, p, e] + _SMALL_JUMP))
                cheapest = min(cheapest, np.int16(lines[before, p, e + 2] + _SMALL_JUMP))
                cost = np.int16(np.int16(costs[j, i, e] + cheapest) - smallest)
                lines[now, i + 1, e + 1] = cost
                totals[j, i, e] = np.int16(totals[j, i, e] + cost)


@large_kernel
def _choose(totals: Costs, best_of_right: NDArray[np.int32], found: NDArray[np.int32]) -> None:
    """Take the cheapest match of every pixel that is unique and that the right pixel answers."""
    height, width, matches = totals.shape
    for j in range(height):
        for i in range(width + matches - 1):
            best_of_right[j, i] = _cheapest_of_right(totals, j, i)
        for i in range(width):
            best = _cheapest(totals, j, i)
            inside = 0 < best < matches - 1
            answered = abs(best_of_right[j, i + best] - best) <= _LARGEST_LEFT_RIGHT_DIFFERENCE
            if inside and answered and _is_unique(totals, j, i, best):
                found[j, i] = (LARGEST_DISPARITY - best) * PARTS - _fraction(totals, j, i, best)


@kernel
def _cheapest(totals: Costs, j: int, i: int) -> int:
    """Match of least cost of a pixel of the left picture, the first of equals."""
    best, cost = 0, totals[j, i, 0]
    for e in range(1, totals.shape[2]):
        if totals[j, i, e] < cost:
            best, cost = e, totals[j, i, e]
    return best


@kernel
def _cheapest_of_right(totals: Costs, j: int, i: int) -> int:
    """Match of least cost of a pixel of the right picture, the first of equals: its left pixels lie at i - e."""
    first: int = max(0, i - totals.shape[1] + 1)
    best, cost = first, totals[j, i - first, first]
    for e in range(first + 1, min(totals.shape[2], i + 1)):
        if totals[j, i - e, e] < cost:
            best, cost = e, totals[j, i - e, e]
    return best


@kernel
def _is_unique(totals: Costs, j: int, i: int, best: int) -> bool:
    """Return whether all matches but the best one's neighbours cost clearly more."""
    limit = int(totals[j, i, best]) * 100
    for e in range(totals.shape[2]):
        if abs(e - best) > 1 and int(totals[j, i, e]) * (100 - _UNIQUENESS_PERCENT) < limit:
            return False
    return True


@kernel
def _fraction(totals: Costs, j: int, i: int, best: int) -> int:
    """Return how far from the best match two lines of opposite slopes through it and its neighbours meet [parts].

    Census costs grow nearly linearly with the distance from the true disparity; a parabola would pull to whole pixels.
    """
    before, here, after = int(totals[j, i, best - 1]), int(totals[j, i, best]), int(totals[j, i, best + 1])
    rise = max(before, after) - here
    if rise <= 0:
        return 0
    return (PARTS * (before - after) + rise) // (2 * rise)


DisparityMap = NDArray[np.int32]
_RADIUS = METHOD.median_width_px // 2
_NEIGHBOURHOOD = (2 * _RADIUS + 1) ** 2


def median_of_neighbours(found: DisparityMap) -> DisparityMap:
    """Replace every disparity by the lower median of those found in its square neighbourhood; gaps (0) stay gaps."""
    smoothed = np.zeros_like(found)
    _write_medians(found, np.empty(_NEIGHBOURHOOD, np.int32), smoothed)
    return smoothed


@large_kernel
def _write_medians(found: DisparityMap, ordered: DisparityMap, smoothed: DisparityMap) -> None:
    height, width = found.shape
    for j in range(height):
        for i in range(width):
            if found[j, i] == 0:
                continue
            count = 0
            for row in range(max(0, j - _RADIUS), min(height, j + _RADIUS + 1)):
                for column in range(max(0, i - _RADIUS), min(width, i + _RADIUS + 1)):
                    value = found[row, column]
                    if value == 0:
                        continue
                    k = count
                    while k > 0 and ordered[k - 1] > value:
                        ordered[k] = ordered[k - 1]
                        k -= 1
                    ordered[k] = value
                    count += 1
            smoothed[j, i] = ordered[(count - 1) // 2]
