"""The projector's pattern: its own, the same for everybody, and fine enough for the matcher's blocks."""

import numpy as np
from vitac.envs.vision.stereo.dot_pattern import HALF_WIDTH, TEXELS, dot_pattern

# Two texels are about one pixel of the infrared cameras, whose focal length is 596 px.
TEXELS_PER_BLOCK = 14


def test_pattern_covers_more_than_the_colour_cameras_picture() -> None:
    assert dot_pattern().shape == (TEXELS, TEXELS)
    assert HALF_WIDTH > 320 / 604.3075


def test_every_block_of_the_matcher_holds_light_and_dark() -> None:
    pattern = dot_pattern()[: TEXELS // TEXELS_PER_BLOCK * TEXELS_PER_BLOCK, : TEXELS // TEXELS_PER_BLOCK * 14]
    blocks = pattern.reshape(TEXELS // TEXELS_PER_BLOCK, TEXELS_PER_BLOCK, -1, TEXELS_PER_BLOCK)
    assert (blocks.max(axis=(1, 3)) > 60).mean() > 0.99
    assert (blocks.min(axis=(1, 3)) == 0).all()


def test_rows_do_not_repeat_within_the_matchers_window() -> None:
    """A pattern that looked like itself 1 to 95 pixels further would be matched there."""
    rows = dot_pattern()[400:414].astype(np.float64) - dot_pattern()[400:414].mean()
    energy = float((rows * rows).sum())
    shifted = [float((rows[:, :-shift] * rows[:, shift:]).sum()) / energy for shift in range(8, 190)]
    assert max(shifted) < 0.4
