import numpy as np
import pytest
from numpy.typing import NDArray
from vitac.envs.drawing.playback import EpisodePlayback
from vitac.envs.playback_files.still import HEIGHT_PX, WIDTH_PX, draw_still


def bounds(mask: NDArray[np.bool_]) -> tuple[int, int, int, int]:
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    return int(rows[0]), int(rows[-1]), int(columns[0]), int(columns[-1])


@pytest.mark.slow
def test_the_still_has_the_whole_scene_in_its_middle_over_a_table_that_fades_in_the_colours_of_the_player(
    peg_playback: EpisodePlayback,
) -> None:
    still = draw_still(peg_playback)
    assert still.shape == (HEIGHT_PX, WIDTH_PX, 4)
    top, bottom, left, right = bounds(still[..., 3] == 255)
    assert 0.02 * HEIGHT_PX < top < 0.15 * HEIGHT_PX
    assert 0.85 * HEIGHT_PX < bottom < 0.98 * HEIGHT_PX
    assert abs(left + right - WIDTH_PX) < 0.1 * WIDTH_PX
    assert still[0, 0, 3] == 0, "beyond the table"
    assert 0 < still[-1, WIDTH_PX // 4, 3] < 255, "the table"
    red, green, blue = still[still[..., 3] == 255, :3].astype(np.int64).T
    assert (red > 1.5 * blue).mean() > 0.2, "the peg"
    assert (blue > 1.3 * red).any(), "a gel where it is pressed in"
    assert ((abs(red - green) < 30) & (abs(green - blue) < 30)).mean() > 0.2, "plate and gripper"
    opacities = np.unique(still[: HEIGHT_PX // 4, :, 3])
    assert len(opacities[(opacities > 0) & (opacities < 255)]) >= 3, "an edge between pixels is smooth"
