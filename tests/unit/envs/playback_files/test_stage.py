import numpy as np
import pytest
from unpacked_files import unpack
from vitac.envs.drawing.playback import EpisodePlayback
from vitac.envs.playback_files.scene import PlaybackTooLarge
from vitac.envs.playback_files.stage import CAMERAS_BYTES, pack_cameras
from vitac.envs.vision.camera import Sight


def packed(playback: EpisodePlayback, **arguments: int) -> bytes:
    content = pack_cameras(playback, **arguments)
    assert content is not None
    return content


def sights_of(playback: EpisodePlayback) -> list[Sight]:
    sights = [playback.moments[index].sight for index in playback.last_moments]
    return [sight for sight in sights if sight is not None]


def test_a_task_without_cameras_has_no_file(peg_playback: EpisodePlayback) -> None:
    assert pack_cameras(peg_playback) is None


def test_there_is_one_look_for_the_reset_and_each_env_step(fusion_playback: EpisodePlayback) -> None:
    content = packed(fusion_playback)
    assert len(content) < CAMERAS_BYTES
    arrays = unpack(content).arrays
    assert arrays["colours"].shape[0] == arrays["depths"].shape[0] == len(fusion_playback.last_moments)


def test_colours_are_those_that_the_policy_saw(fusion_playback: EpisodePlayback) -> None:
    found = unpack(packed(fusion_playback))
    row, column = found.header["first_row"], found.header["first_column"]
    for number, sight in enumerate(sights_of(fusion_playback)):
        shown = found.arrays["palette"][found.arrays["colours"][number]]
        rows, columns = shown.shape[:2]
        np.testing.assert_array_equal(shown, sight.colours[row : row + rows, column : column + columns])


def test_depths_are_unknown_where_the_camera_found_none_and_else_near_the_measured(
    fusion_playback: EpisodePlayback,
) -> None:
    found = unpack(packed(fusion_playback))
    nearest, farthest = found.header["nearest_mm"], found.header["farthest_mm"]
    row, column = found.header["first_row"], found.header["first_column"]
    levels, sight = found.arrays["depths"][0], sights_of(fusion_playback)[0]
    rows, columns = levels.shape
    depths_mm = 1e3 * sight.depth_m[row : row + rows, column : column + columns].astype(float)
    np.testing.assert_array_equal(levels == 0, depths_mm == 0)
    shown_mm = nearest + (levels - 1.0) / 254 * (farthest - nearest)
    within = (depths_mm > nearest) & (depths_mm < farthest)
    assert np.abs(shown_mm - depths_mm)[within].max() <= (farthest - nearest) / 254


def test_pixels_are_left_out_until_the_file_is_small_enough(fusion_playback: EpisodePlayback) -> None:
    whole = packed(fusion_playback)
    found = unpack(packed(fusion_playback, at_most=len(whole) - 1))
    assert found.header["every_px"] == 2
    assert found.arrays["depths"].shape[1] < unpack(whole).arrays["depths"].shape[1]


def test_pictures_that_cannot_be_made_small_are_refused(fusion_playback: EpisodePlayback) -> None:
    with pytest.raises(PlaybackTooLarge, match="at most 10 bytes"):
        pack_cameras(fusion_playback, at_most=10)


def test_many_colours_are_brought_down_to_a_palette(
    fusion_playback: EpisodePlayback, monkeypatch: pytest.MonkeyPatch
) -> None:
    random = np.random.default_rng(3)
    picture = random.integers(0, 256, (480, 640, 3)).astype(np.uint8)
    for sight in sights_of(fusion_playback):
        monkeypatch.setitem(sight.__dict__, "colours", picture)
    found = unpack(packed(fusion_playback, at_most=10**8))
    shown = found.arrays["palette"][found.arrays["colours"][0]].astype(int)
    row, column = found.header["first_row"], found.header["first_column"]
    seen = picture[row : row + shown.shape[0], column : column + shown.shape[1]].astype(int)
    assert len(found.arrays["palette"]) <= 256
    assert np.abs(shown - seen).max() < 64
