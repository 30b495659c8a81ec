"""Median of disparities: against a plain definition."""

import numpy as np
from vitac.envs.vision.stereo.median import median_of_neighbours


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
