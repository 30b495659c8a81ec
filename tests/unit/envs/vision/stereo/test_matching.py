"""The matcher's steps against plain definitions of them, and its answers on pictures of known disparity."""

import numpy as np
import pytest
from numpy.typing import NDArray
from vitac.envs.vision.stereo import matching
from vitac.envs.vision.stereo.matching import (
    LARGEST_DISPARITY,
    MATCHES,
    NO_DISPARITY,
    PARTS,
    disparities,
    median_of_neighbours,
)

LARGEST_BLOCK_COST = 48 * 49


def census(picture: NDArray[np.uint8]) -> NDArray[np.uint64]:
    codes = np.zeros(picture.shape, np.uint64)
    matching._census(picture, codes)
    return codes


def smooth_texture(width: int, step: float, *, height: int = 40) -> NDArray[np.uint8]:
    """Waves of many lengths, sampled at `step` further right."""
    random = np.random.default_rng(4)
    x, y = np.arange(width) + step, np.arange(height)[:, None]
    total = np.zeros((height, width))
    for _ in range(40):
        wave_x, wave_y, phase = random.uniform(-1.2, 1.2), random.uniform(-1.2, 1.2), random.uniform(0, 6.28)
        total += np.cos(wave_x * x + wave_y * y + phase)
    return np.clip(128 + 18 * total, 0, 255).astype(np.uint8)


def pair_of(disparity: float, width: int = 60) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Left and right picture of one plane: left column i shows what right column i - disparity shows.

    Column k of the right picture stands for k - LARGEST_DISPARITY.
    """
    left = smooth_texture(width, 0.0)
    right = smooth_texture(width + MATCHES - 1, disparity - LARGEST_DISPARITY)
    return left, right


def speckled_pair_of(disparity: int, width: int = 60) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """The same of a plane on which no two pixels are alike."""
    texture = np.random.default_rng(7).integers(0, 256, (40, width + MATCHES + 100)).astype(np.uint8)
    first = 50 + disparity - LARGEST_DISPARITY
    return texture[:, 50 : 50 + width].copy(), texture[:, first : first + width + MATCHES - 1].copy()


def test_census_says_which_neighbours_are_darker() -> None:
    picture = np.random.default_rng(0).integers(0, 256, (12, 15)).astype(np.uint8)
    neighbours = [(dj, di) for dj in range(-3, 4) for di in range(-3, 4) if (dj, di) != (0, 0)]
    expected = 0
    for dj, di in neighbours:
        expected = 2 * expected + int(picture[6 + dj, 8 + di] < picture[6, 8])
    assert int(census(picture)[6, 8]) == expected


def test_census_ignores_brightness_and_contrast() -> None:
    dark = np.random.default_rng(0).integers(0, 100, (12, 15)).astype(np.uint8)
    np.testing.assert_array_equal(census(dark), census(2 * dark + 30))


def test_costs_count_the_bits_that_differ() -> None:
    random = np.random.default_rng(1)
    left = random.integers(0, 2**48, (3, 5)).astype(np.uint64)
    right = random.integers(0, 2**48, (3, 5 + MATCHES - 1)).astype(np.uint64)
    costs = np.zeros((3, 5, MATCHES), np.int16)
    matching._compare(left, right, costs)
    for j, i, e in ((0, 0, 0), (1, 3, 7), (2, 4, MATCHES - 1)):
        assert costs[j, i, e] == bin(int(left[j, i]) ^ int(right[j, i + e])).count("1")


def test_block_costs_are_sums_over_seven_by_seven_pixels_inside_the_picture() -> None:
    costs = np.random.default_rng(2).integers(0, 49, (11, 13, 3)).astype(np.int16)
    blocks = np.zeros_like(costs)
    matching._sum_blocks(costs, np.zeros((14, 3), np.int16), blocks)
    for j in range(11):
        for i in range(13):
            window = costs[max(0, j - 3) : j + 4, max(0, i - 3) : i + 4]
            np.testing.assert_array_equal(blocks[j, i], window.sum(axis=(0, 1)))


def path_costs(costs: NDArray[np.int64], row_step: int, column_step: int) -> NDArray[np.int64]:
    """L(p, d) = C(p, d) + min(L(q, d), L(q, d -+ 1) + P1, min L(q) + P2) - min L(q), q before p (eq. 13)."""
    height, width, matches = costs.shape
    paths = costs.copy()
    rows = range(height) if row_step >= 0 else range(height - 1, -1, -1)
    columns = range(width) if column_step >= 0 else range(width - 1, -1, -1)
    for j in rows:
        for i in columns:
            row, column = j - row_step, i - column_step
            if 0 <= row < height and 0 <= column < width:
                before = paths[row, column]
                padded = np.concatenate([[10**6], before, [10**6]]) + 8 * 49
                choices = np.array([before, padded[:-2], padded[2:], np.full(matches, before.min() + 32 * 49)])
                paths[j, i] = costs[j, i] + choices.min(axis=0) - before.min()
    return paths


PATHS = {side: [(0, side), (side, -side), (side, 0), (side, side)] for side in (1, -1)}


@pytest.mark.parametrize("side", PATHS)
@pytest.mark.parametrize("costs_are", ["small", "extreme"])
def test_path_costs_are_those_of_the_paper(side: int, costs_are: str) -> None:
    random = np.random.default_rng(5)
    shape = (9, 12, MATCHES)
    costs = (
        random.integers(0, 2000, shape) if costs_are == "small" else random.integers(0, 2, shape) * LARGEST_BLOCK_COST
    )
    totals, lines = np.zeros(shape, np.int16), np.ones((4, 2, 14, MATCHES + 2), np.int16)
    matching._add_paths(costs.astype(np.int16), lines, totals, side)
    np.testing.assert_array_equal(totals, sum(path_costs(costs, *step) for step in PATHS[side]))


def test_eight_paths_of_the_largest_costs_fit_their_numbers() -> None:
    assert tuple(PATHS) == matching._SIDES
    assert (LARGEST_BLOCK_COST + 32 * 49) * sum(map(len, PATHS.values())) < 2**15


@pytest.mark.parametrize("disparity", [50, 63, 82, 94])
def test_whole_disparities_are_found_everywhere(disparity: int) -> None:
    found = disparities(*pair_of(disparity))
    inside = found[4:-4, 4:-4]
    assert (inside != NO_DISPARITY).mean() > 0.99
    assert np.quantile(np.abs(inside[inside != NO_DISPARITY] / PARTS - disparity), 0.95) < 0.1


@pytest.mark.parametrize("disparity", [60.25, 70.5, 80.75])
def test_fractions_of_a_pixel_are_found_to_a_fifth(disparity: float) -> None:
    """Census costs rise less than linearly, which pulls a quarter of a pixel by 0.12 px to the whole one."""
    found = disparities(*pair_of(disparity))
    error = found[4:-4, 4:-4][found[4:-4, 4:-4] != NO_DISPARITY] / PARTS - disparity
    assert abs(np.median(error)) < 0.13
    assert np.quantile(np.abs(error), 0.9) < 0.2


def test_a_larger_disparity_is_found_larger() -> None:
    medians = [np.median(disparities(*pair_of(70 + tenth / 10))[6:-6, 6:-6]) for tenth in range(11)]
    assert (np.diff(medians) > 0).all()


@pytest.mark.parametrize("disparity", [30, 48, 95, 110])
def test_what_lies_beyond_the_range_is_not_matched(disparity: int) -> None:
    assert (disparities(*speckled_pair_of(disparity)) != NO_DISPARITY).mean() < 0.2


def test_dark_pictures_have_no_match() -> None:
    assert (disparities(np.zeros((20, 30), np.uint8), np.zeros((20, 30 + MATCHES - 1), np.uint8)) == 0).all()


def test_unrelated_pictures_are_mostly_refused() -> None:
    random = np.random.default_rng(8)
    left = random.integers(0, 256, (40, 60)).astype(np.uint8)
    right = random.integers(0, 256, (40, 60 + MATCHES - 1)).astype(np.uint8)
    assert (disparities(left, right) != NO_DISPARITY).mean() < 0.1


def test_what_only_the_left_picture_shows_is_not_matched() -> None:
    """A near stripe hides part of the far plane from the right camera: as wide as the disparities differ."""
    left, right = speckled_pair_of(55)
    near_left = np.random.default_rng(9).integers(0, 256, (40, 20)).astype(np.uint8)
    left[:, 30:50] = near_left
    first = 30 - 75 + LARGEST_DISPARITY
    right[:, first : first + 20] = near_left
    found = disparities(left, right)[5:-5]
    assert np.abs(found[:, 33:47] / PARTS - 75).max() < 0.1
    # Left of the stripe, columns 10 to 29 fall behind it in the right picture.
    assert (found[:, 14:26] != NO_DISPARITY).mean() < 0.1
    assert np.abs(found[:, 4:7] / PARTS - 55).max() < 0.2


def test_every_disparity_becomes_the_median_of_those_found_around_it() -> None:
    random = np.random.default_rng(0)
    found = random.integers(1, 100, (17, 23)).astype(np.int32)
    found[random.random(found.shape) < 0.4] = 0
    smoothed = median_of_neighbours(found)
    for j in range(17):
        for i in range(23):
            around = found[max(0, j - 1) : j + 2, max(0, i - 1) : i + 2]
            ordered = np.sort(around[around > 0])
            expected = ordered[(len(ordered) - 1) // 2] if found[j, i] else 0
            assert smoothed[j, i] == expected


def test_a_single_wrong_match_vanishes() -> None:
    found = np.full((5, 5), 70, np.int32)
    found[2, 2] = 50
    assert (median_of_neighbours(found) == 70).all()
