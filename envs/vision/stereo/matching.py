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
# Paths come from one side of a pixel, then from the other: from beside, above, and both diagonals.
_PATHS_OF_SIDE = 4
_SIDES = (1, -1)[: METHOD.paths // _PATHS_OF_SIDE]
# A cost and its match in one number, whose order is that of costs, then of matches.
_KEYS = np.int32(64)
_NO_KEY, _NO_COST = np.int32(2**31 - 1), np.int16(2**15 - 1)
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
    costs, blocks, totals = (np.zeros((height, width, MATCHES), np.int16) for _ in range(3))
    _compare(left_codes, right_codes, costs)
    _sum_blocks(costs, np.zeros((width + 1, MATCHES), np.int16), blocks)
    lines = np.zeros((_PATHS_OF_SIDE, 2, width + 2, MATCHES + 2), np.int16)
    for side in _SIDES:
        _add_paths(blocks, lines, totals, side)
    disparity = np.zeros(left.shape, np.int32)
    _choose(totals, np.empty(width + MATCHES - 1, np.int32), disparity)
    return disparity


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
    for j in range(height):
        for dj in range(max(-r, -j), min(r, height - 1 - j) + 1):
            for di in range(-r, r + 1):
                if dj == 0 and di == 0:
                    continue
                first, last = max(0, -di), min(width, width - di)
                other, own, code = picture[j + dj, first + di : last + di], picture[j, first:last], codes[j, first:last]
                for i in range(len(code)):
                    code[i] = (code[i] << np.uint64(1)) | np.uint64(other[i] < own[i])


@large_kernel
def _compare(left: Codes, right: Codes, costs: Costs) -> None:
    """Count the census bits in which a pixel and its match differ."""
    height, width, matches = costs.shape
    for j in range(height):
        for i in range(width):
            for e in range(matches):
                costs[j, i, e] = _count_ones(left[j, i] ^ right[j, i + e])  # type: ignore[call-arg]


@large_kernel
def _sum_blocks(costs: Costs, sums: Costs, blocks: Costs) -> None:
    """Sum the costs over the block around every pixel; what enters a block is added, what leaves it taken away.

    `sums`, zeros at first, holds those over the block's rows for each column, and in its last row those over the block.
    """
    height, width, matches = costs.shape
    r, block = _BLOCK_RADIUS, sums[width]
    for j in range(height):
        for k in range(0 if j == 0 else j + r, min(height, j + r + 1)):
            for i in range(width):
                for e in range(matches):
                    sums[i, e] += costs[k, i, e]
        if j > r:
            for i in range(width):
                for e in range(matches):
                    sums[i, e] -= costs[j - r - 1, i, e]
        block[:] = 0
        for i in range(width):
            for k in range(0 if i == 0 else i + r, min(width, i + r + 1)):
                for e in range(matches):
                    block[e] += sums[k, e]
            if i > r:
                for e in range(matches):
                    block[e] -= sums[i - r - 1, e]
            for e in range(matches):
                blocks[j, i, e] = block[e]


@large_kernel
def _add_paths(costs: Costs, lines: Costs, totals: Costs, side: int) -> None:
    """Add to the totals the costs of the cheapest paths that reach each pixel from one side (eq. 13).

    `lines` holds the path costs of the row before and of this one, with a border of columns that cost nothing. All
    paths of a side are followed at once, since reading the costs takes longer than following.
    """
    height, width, matches = costs.shape
    lines[:, :, :, :] = 0
    lines[:, :, 1 : width + 1, 0] = _FAR
    lines[:, :, 1 : width + 1, matches + 1] = _FAR
    for jj in range(height):
        j = jj if side > 0 else height - 1 - jj
        now = jj % 2
        for ii in range(width):
            i = ii if side > 0 else width - 1 - ii
            for path in range(_PATHS_OF_SIDE):
                before, step = (now, side) if path == 0 else (1 - now, (path - 2) * side)
                line, here = lines[path, before, i + 1 - step], lines[path, now, i + 1]
                smallest = _FAR
                for e in range(1, matches + 1):
                    smallest = min(smallest, line[e])
                jump = np.int16(smallest + _LARGE_JUMP)
                for e in range(matches):
                    cheapest = min(line[e + 1], jump)
                    cheapest = min(cheapest, np.int16(line[e] + _SMALL_JUMP))
                    cheapest = min(cheapest, np.int16(line[e + 2] + _SMALL_JUMP))
                    cost = np.int16(np.int16(costs[j, i, e] + cheapest) - smallest)
                    here[e + 1] = cost
                    totals[j, i, e] = np.int16(totals[j, i, e] + cost)


@large_kernel
def _choose(totals: Costs, best_of_right: NDArray[np.int32], disparity: NDArray[np.int32]) -> None:
    """Take the cheapest match of every pixel that is unique and that the right pixel answers, the first of equals."""
    height, width, matches = totals.shape
    for j in range(height):
        best_of_right[:] = _NO_KEY
        for i in range(width):
            for e in range(matches):
                best_of_right[i + e] = min(best_of_right[i + e], _key(totals[j, i, e], e))
        for i in range(width):
            cheapest = _NO_KEY
            for e in range(matches):
                cheapest = min(cheapest, _key(totals[j, i, e], e))
            best = int(cheapest % _KEYS)
            inside = 0 < best < matches - 1
            answered = abs(best_of_right[i + best] % _KEYS - best) <= _LARGEST_LEFT_RIGHT_DIFFERENCE
            if inside and answered and _is_unique(totals[j, i], best):
                disparity[j, i] = (LARGEST_DISPARITY - best) * PARTS - _fraction(totals, j, i, best)


@kernel
def _key(cost: np.int16, match: int) -> np.int32:
    return np.int32(_KEYS * cost + match)


@kernel
def _is_unique(costs: NDArray[np.int16], best: int) -> bool:
    """Return whether all matches but the best one's neighbours cost clearly more."""
    smallest = _NO_COST
    for e in range(best - 1):
        smallest = min(smallest, costs[e])
    for e in range(best + 2, len(costs)):
        smallest = min(smallest, costs[e])
    return int(smallest) * (100 - _UNIQUENESS_PERCENT) >= int(costs[best]) * 100


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


def median_of_neighbours(disparity: DisparityMap) -> DisparityMap:
    """Replace every disparity by the lower median of those found in its square neighbourhood; gaps (0) stay gaps."""
    smoothed = np.zeros_like(disparity)
    _write_medians(disparity, np.empty(_NEIGHBOURHOOD, np.int32), smoothed)
    return smoothed


@large_kernel
def _write_medians(disparity: DisparityMap, ordered: DisparityMap, smoothed: DisparityMap) -> None:
    height, width = disparity.shape
    for j in range(height):
        for i in range(width):
            if disparity[j, i] == 0:
                continue
            count = 0
            for row in range(max(0, j - _RADIUS), min(height, j + _RADIUS + 1)):
                for column in range(max(0, i - _RADIUS), min(width, i + _RADIUS + 1)):
                    value = disparity[row, column]
                    if value == 0:
                        continue
                    k = count
                    while k > 0 and ordered[k - 1] > value:
                        ordered[k] = ordered[k - 1]
                        k -= 1
                    ordered[k] = value
                    count += 1
            smoothed[j, i] = ordered[(count - 1) // 2]
