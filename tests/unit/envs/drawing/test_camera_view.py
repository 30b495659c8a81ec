"""Pictures of what the camera rig sees."""

from dataclasses import replace

import numpy as np
import pytest
from fake_scene import FakeScene
from vitac.envs.drawing.camera_view import (
    CameraStrip,
    DrawnQuantity,
    camera_sheet,
    colouring,
    rendered_sheet,
    round_limits,
)
from vitac.envs.drawing.drawable import straight_to_target
from vitac.envs.drawing.picture import Caption, draw
from vitac.envs.drawing.playback import EpisodePlayback, Pace, record
from vitac.envs.drawing.projection import PictureCrop
from vitac.envs.tasks.fusion_insertion.env import FusionInsertionEnv
from vitac.envs.tasks.task_env import Info, Observation
from vitac.envs.vision.camera import Sight
from vitac.envs.vision.renderer import RenderMode

OPTIONS = {"start": (0.0, 0.0, 0.0, 3.0, 1), "rng_seed": (0, 1)}


@pytest.fixture
def playback(fake_scenes: list[FakeScene]) -> EpisodePlayback:
    env = FusionInsertionEnv(max_steps=2)
    return record(env, options=OPTIONS, next_action=straight_to_target(env.env_id), pace=Pace.IPC_STEP)


def sights_of(playback: EpisodePlayback) -> list[Sight]:
    sights = [moment.sight for moment in playback.moments]
    assert all(sight is not None for sight in sights)
    return [sight for sight in sights if sight is not None]


def test_between_env_steps_the_pictures_of_the_last_one_stay(playback: EpisodePlayback) -> None:
    sights, ends = sights_of(playback), playback.last_moments
    assert len(sights) > len(ends)
    assert len({id(sight) for sight in sights}) == len(ends)
    assert sights[ends[0] + 1] is sights[ends[0]]


def test_keeping_sights_changes_no_observation(fake_scenes: list[FakeScene]) -> None:
    env, seen = FusionInsertionEnv(max_steps=2), []
    move = straight_to_target(env.env_id)

    def look_and_move(observation: Observation, info: Info) -> np.ndarray | None:
        seen.append(observation["depth_picture"])
        return move(observation, info)

    playback = record(env, options=OPTIONS, next_action=look_and_move, pace=Pace.IPC_STEP)
    sights = [sights_of(playback)[index] for index in playback.last_moments]
    for observed, sight in zip(seen, sights, strict=False):
        np.testing.assert_array_equal(observed, sight.depth_m)


def test_a_frame_holds_all_that_is_ever_seen_and_nothing_far_from_it(playback: EpisodePlayback) -> None:
    sights = sights_of(playback)
    frame = PictureCrop.around(sights)
    for sight in sights:
        shown = sight.segmentation > 0
        assert shown[frame.rows, frame.columns].sum() == shown.sum()
    assert frame.rows.stop - frame.rows.start < 200
    assert 300 < frame.nearest_mm < frame.farthest_mm < 600


def test_the_camera_stands_below_the_scene_in_the_same_width(playback: EpisodePlayback) -> None:
    caption = Caption(title="title", actions="actions")
    *_, picture = draw(playback, caption, quantity=DrawnQuantity.STRESS, width_px=600, moments=slice(0, 1))
    sight = sights_of(playback)[0]
    strip = CameraStrip(sights_of(playback), width_px=600).picture(sight)
    assert picture.shape == (342 + len(strip), 600, 3)
    np.testing.assert_array_equal(picture[342:], strip)
    reds = (strip[..., 0] > 200) & (strip[..., 1] < 100) & (strip[..., 2] < 100)
    assert reds.sum() > 500


def test_a_strip_shows_nothing_of_those_that_were_drawn_before(playback: EpisodePlayback) -> None:
    sights = sights_of(playback)
    strip = CameraStrip(sights, width_px=600)
    for sight in (sights[-1], sights[0]):
        np.testing.assert_array_equal(strip.picture(sight), CameraStrip(sights, width_px=600).picture(sight))
    assert not np.array_equal(strip.picture(sights[-1]), strip.picture(sights[0]))


def test_the_sheet_shows_every_picture_and_looks_the_same_twice(playback: EpisodePlayback) -> None:
    sight = sights_of(playback)[0]
    sheet = camera_sheet(sight, "title", width_px=600)
    assert sheet.shape == (384, 600, 3)
    assert sheet.dtype == np.uint8
    np.testing.assert_array_equal(sheet, camera_sheet(sight, "title", width_px=600))
    assert (sheet[200:, :380] < 30).all(axis=2).mean() > 0.2  # The infrared pictures are dark.


def test_a_camera_that_sees_nothing_is_drawn(playback: EpisodePlayback) -> None:
    sight = sights_of(playback)[0]
    sight.__dict__["segmentation"] = np.zeros((480, 640), np.uint8)
    sight.__dict__["depth_m"] = np.zeros((480, 640), np.float32)
    frame = PictureCrop.around([sight])
    assert (frame.rows, frame.columns) == (slice(0, 480), slice(0, 640))
    assert camera_sheet(sight, "title", width_px=600).shape == (384, 600, 3)


def test_a_rendered_picture_is_drawn_beside_ours(playback: EpisodePlayback) -> None:
    sight = sights_of(playback)[0]
    dark, light = (
        rendered_sheet(sight, np.full_like(sight.colours, grey), "title", mode=RenderMode.RT, width_px=600)
        for grey in (0, 255)
    )
    assert dark.shape == light.shape == (204, 600, 3)
    differs = np.any(dark != light, axis=(0, 2))
    assert not differs[:300].any()
    assert differs[300:].sum() > 100


@pytest.mark.parametrize(
    ("low", "high", "expected"),
    [
        (0.0, 0.0, (0.0, 1.0)),
        (0.0, 87.0, (0.0, 90.0)),
        (12.3, 19.1, (12.0, 20.0)),
        (0.013, 0.94, (0.0, 1.0)),
        (0, 1, (0, 1)),
    ],
)
def test_limits_are_round_and_hold_the_range(low: float, high: float, expected: tuple[float, float]) -> None:
    assert round_limits(low, high) == pytest.approx(expected)


def test_displacement_is_in_millimetres(peg_playback: EpisodePlayback) -> None:
    found = colouring(peg_playback, DrawnQuantity.DISPLACEMENT)
    assert found.label == "displacement [mm]"
    assert len(found.values) == len(peg_playback.moments)
    for gel in found.values[-1]:
        assert gel[peg_playback.gel.sensing] == pytest.approx(0.6)
        assert gel[peg_playback.gel.driven] == pytest.approx(0.0, abs=1e-9)
    assert (found.lowest, found.highest) == pytest.approx((0.0, 0.6))


def test_stress_of_a_pressed_gel_is_that_of_confined_compression(peg_playback: EpisodePlayback) -> None:
    found = colouring(peg_playback, DrawnQuantity.STRESS)
    assert found.label == "von Mises stress [kPa]"
    stretch = (4.0 - 0.6) / 4.0
    mu_kpa = 300.0 / 2.6
    expected = abs(mu_kpa * (stretch**2 - 1) / stretch)
    middle = np.abs(peg_playback.gel.rest_position_m[:, :2]).max(axis=1) < 1e-6
    for gel in found.values[0]:
        assert gel[middle] == pytest.approx(expected)
    assert found.lowest <= expected <= found.highest


def test_one_scale_fits_all_moments(peg_playback: EpisodePlayback) -> None:
    whole = colouring(peg_playback, DrawnQuantity.STRESS)
    alone = colouring(replace(peg_playback, moments=peg_playback.moments[:1]), DrawnQuantity.STRESS)
    assert whole.lowest <= alone.lowest
    assert whole.highest >= alone.highest
