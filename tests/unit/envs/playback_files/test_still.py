import numpy as np
from numpy.typing import NDArray
from vitac.envs.drawing.playback import EpisodePlayback
from vitac.envs.playback_files.still import HEIGHT_PX, WIDTH_PX, draw_still


def bounds(mask: NDArray[np.bool_]) -> tuple[int, int, int, int]:
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    return int(rows[0]), int(rows[-1]), int(columns[0]), int(columns[-1])


def test_the_still_has_the_whole_scene_in_its_middle_over_a_table_that_fades(peg_playback: EpisodePlayback) -> None:
    still = draw_still(peg_playback)
    assert still.shape == (HEIGHT_PX, WIDTH_PX, 4)
    top, bottom, left, right = bounds(still[..., 3] == 255)
    assert 0.02 * HEIGHT_PX < top < 0.15 * HEIGHT_PX
    assert 0.85 * HEIGHT_PX < bottom < 0.98 * HEIGHT_PX
    assert abs(left + right - WIDTH_PX) < 0.1 * WIDTH_PX
    assert still[0, 0, 3] == 0, "beyond the table"
    assert 0 < still[-1, WIDTH_PX // 4, 3] < 255, "the table"


def test_gels_are_coloured_by_how_far_they_are_moved_and_parts_have_the_colours_of_the_player(
    peg_playback: EpisodePlayback,
) -> None:
    red, green, blue = still_colours(peg_playback)
    assert (red > 1.5 * blue).mean() > 0.2, "the peg"
    assert (blue > 1.3 * red).any(), "a gel where it is pressed in"
    assert ((abs(red - green) < 30) & (abs(green - blue) < 30)).mean() > 0.2, "plate and gripper"


def still_colours(playback: EpisodePlayback) -> NDArray[np.int64]:
    still = draw_still(playback).astype(np.int64)
    return still[still[..., 3] == 255, :3].T


def test_an_edge_between_pixels_is_smooth(peg_playback: EpisodePlayback) -> None:
    opacities = np.unique(draw_still(peg_playback)[: HEIGHT_PX // 4, :, 3])
    assert len(opacities[(opacities > 0) & (opacities < 255)]) >= 3
