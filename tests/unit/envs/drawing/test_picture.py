from dataclasses import replace

import numpy as np
import pytest
from fake_scene import FakeScene
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text
from vitac.envs.drawing.camera_view import DrawnQuantity
from vitac.envs.drawing.drawable import NotDrawable, find_perspective, straight_to_target
from vitac.envs.drawing.picture import Caption, Painter, draw, picture_size_px
from vitac.envs.drawing.playback import EpisodePlayback, record
from vitac.envs.drawing.sensor_view import arrows, magnification
from vitac.envs.scene.perspective import DESCRIPTION
from vitac.envs.tasks.lock_opening.env import LockOpeningEnv
from vitac.envs.tasks.peg_insertion.env import PegInsertionEnv

CAPTION = Caption(title="Peg insertion, episode 5: trapezoid", actions=DESCRIPTION)


@pytest.fixture
def lock_playback(fake_scenes: list[FakeScene], monkeypatch: pytest.MonkeyPatch) -> EpisodePlayback:
    monkeypatch.setattr(FakeScene, "bulge_m", -6e-4)
    env = LockOpeningEnv()
    options = {"shape": "key4", "offset_mm": (0.0, 0.0, 0.0), "rng_seed": (0, 1)}
    return record(env, options=options, next_action=straight_to_target(env.env_id))


def painted(playback: EpisodePlayback, quantity: DrawnQuantity = DrawnQuantity.STRESS) -> Painter:
    return Painter(playback, CAPTION, quantity=quantity, width_px=600)


def texts(figure: Figure) -> list[str]:
    return [text.get_text() for text in figure.findobj(Text) if text.get_text()]


def rendered(figure: Figure) -> np.ndarray:
    canvas = FigureCanvasAgg(figure)
    canvas.draw()  # type: ignore[no-untyped-call]
    return np.asarray(canvas.buffer_rgba())  # type: ignore[no-untyped-call]


def test_draws_every_moment_at_the_size_that_was_asked_for(peg_playback: EpisodePlayback) -> None:
    pictures = list(draw(peg_playback, CAPTION, quantity=DrawnQuantity.STRESS, width_px=600))
    assert len(pictures) == len(peg_playback.moments)
    assert picture_size_px(600) == (600, 342)
    assert {picture.shape for picture in pictures} == {(342, 600, 3)}
    assert all(picture.dtype == np.uint8 for picture in pictures)


def test_the_same_episode_gives_the_same_picture(peg_playback: EpisodePlayback) -> None:
    first, second = (painted(peg_playback).picture(1) for _ in range(2))
    assert np.array_equal(first, second)


@pytest.mark.slow
def test_a_picture_shows_nothing_of_those_that_were_drawn_before(peg_playback: EpisodePlayback) -> None:
    first, *others = peg_playback.moments
    believed = replace(first, belief_error=np.array([2.0, -1.0, 30.0]))
    playback = replace(peg_playback, moments=(believed, *others))
    painter = painted(playback)
    for index in (len(others), 0, 1, 0):
        np.testing.assert_array_equal(painter.picture(index), painted(playback).picture(index))


@pytest.mark.slow
def test_moments_and_quantities_differ(peg_playback: EpisodePlayback) -> None:
    stress = painted(peg_playback)
    assert not np.array_equal(stress.picture(0), stress.picture(2))
    assert not np.array_equal(stress.picture(0), painted(peg_playback, DrawnQuantity.DISPLACEMENT).picture(0))


def test_only_chosen_moments_are_drawn(peg_playback: EpisodePlayback) -> None:
    (only,) = draw(peg_playback, CAPTION, quantity=DrawnQuantity.STRESS, width_px=600, moments=slice(2, 3))
    assert np.array_equal(only, painted(peg_playback).picture(2))


def test_caption_says_step_offset_surface_motion_and_outcome(peg_playback: EpisodePlayback) -> None:
    painter = painted(peg_playback)
    first, last = (texts(painter.figure(index)) for index in (0, len(peg_playback.moments) - 1))
    assert "after the grasp" in first
    assert any("offset x −3.00 mm, y +1.50 mm, θ +6.00°" in text for text in first)
    assert any("surface_diff left 0.00 mm, right 0.00 mm" in text for text in first)
    assert "env step 3 of 3: success" in last
    assert any("offset x +0.00 mm" in text for text in last)
    assert CAPTION.title in last
    assert f"actions: {DESCRIPTION}" in last


def test_caption_says_what_the_policy_believes_beside_what_is_true(peg_playback: EpisodePlayback) -> None:
    moment = replace(peg_playback.moments[0], belief_error=np.array([0.5, -2.0, 0.25]))
    figure = painted(replace(peg_playback, moments=(moment, *peg_playback.moments[1:]))).figure(0)
    assert "believed: offset x −2.50 mm, y −0.50 mm, θ +6.25°" in texts(figure)
    assert not any("believed" in text for text in texts(painted(peg_playback).figure(0)))


@pytest.mark.parametrize("task", ["peg_playback", "lock_playback"])
def test_parts_sensors_and_units_are_named(task: str, request: pytest.FixtureRequest) -> None:
    playback = request.getfixturevalue(task)
    found = texts(painted(playback).figure(0))
    perspective = find_perspective(playback.env_id)
    for name in ("left gel", "right gel", perspective.held_name, perspective.fixed_name, "von Mises stress [kPa]"):
        assert name in found
    for side in ("left", "right"):
        assert any(text.startswith(f"{side} sensor, marker flow ×") for text in found)


@pytest.mark.parametrize("task", ["peg_playback", "lock_playback"])
def test_nothing_is_written_beyond_the_edge(task: str, request: pytest.FixtureRequest) -> None:
    figure = painted(request.getfixturevalue(task)).figure(1)
    rendered(figure)
    box = figure.get_tightbbox()
    width_in, height_in = figure.get_size_inches()
    assert box.x0 >= 0
    assert box.y0 >= 0
    assert box.x1 <= width_in
    assert box.y1 <= height_in


@pytest.mark.parametrize("task", ["peg_playback", "lock_playback"])
def test_lines_of_the_caption_stand_apart(task: str, request: pytest.FixtureRequest) -> None:
    playback = request.getfixturevalue(task)
    if task == "peg_playback":
        moments = tuple(replace(each, belief_error=np.array([20.0, -20.0, 40.0])) for each in playback.moments)
        playback = replace(playback, moments=moments)
    caption = Caption(title="Peg insertion, episode 270: trapezoid", actions="a policy with a long name " * 10)
    figure = Painter(playback, caption, quantity=DrawnQuantity.STRESS, width_px=600).figure(1)
    rendered(figure)
    lines = [text.get_window_extent() for text in figure.texts]
    plots = [box for axes in figure.axes if (box := axes.get_tightbbox()) is not None]
    assert len(plots) == 6
    for index, line in enumerate(lines):
        assert not any(line.overlaps(other) for other in [*lines[index + 1 :], *plots])


def test_gels_are_coloured_and_the_ground_is_light(peg_playback: EpisodePlayback) -> None:
    picture = painted(peg_playback).picture(0).astype(int)
    assert (picture[:4] == 255).all()
    scene = picture[:, :300]
    reddish = (scene[..., 0] - scene[..., 2] > 80) & (scene[..., 0] > 150)
    assert 0.01 < reddish.mean() < 0.3


def test_an_environment_without_a_view_is_refused(peg_playback: EpisodePlayback) -> None:
    other = replace(peg_playback, env_id="ViTac/Other-v1")
    with pytest.raises(NotDrawable, match=r"views of ViTac/Assembly-v1, ViTac/CableEnd-v1, .*ViTac/PegInsertion-v1"):
        painted(other)


def test_every_marker_has_one_arrow() -> None:
    reference = np.array([[10.0, 20.0], [30.0, 40.0], [30.0, 40.0]], dtype=np.float32)
    flow = np.array([[1.0, 2.0], [-3.0, 0.5], [-3.0, 0.5]], dtype=np.float32)
    start, length = arrows(np.stack([reference, reference + flow]))
    assert start.tolist() == [[10.0, 20.0], [30.0, 40.0]]
    assert length.tolist() == [[1.0, 2.0], [-3.0, 0.5]]


@pytest.mark.parametrize(("longest_px", "expected"), [(0.0, 20), (2.0, 20), (4.0, 10), (20.0, 2), (80.0, 1)])
def test_arrows_are_lengthened_as_far_as_they_stay_readable(
    peg_playback: EpisodePlayback, longest_px: float, expected: int
) -> None:
    flow = np.zeros((2, 2, 128, 2), dtype=np.float32)
    flow[1, 1, 7, 0] = longest_px
    moment = replace(peg_playback.moments[0], marker_flow=flow)
    assert magnification(replace(peg_playback, moments=(moment,))) == expected


@pytest.mark.parametrize("offset", [(-4.0, -4.0, -8.0), (4.0, 2.0, -2.0), (0.0, 0.0, 6.0), (-1.0, 3.0, 4.0)])
def test_peg_goes_straight_to_its_hole(fake_scenes: list[FakeScene], offset: tuple[float, float, float]) -> None:
    env = PegInsertionEnv()
    options = {"shape": "cuboid", "offset_mm_deg": offset, "rng_seed": (0, 1)}
    playback = record(env, options=options, next_action=straight_to_target(env.env_id))
    left = [np.linalg.norm(moment.info["gt_offset_mm_deg"]) for moment in playback.moments]
    assert (np.diff(left) <= 1e-9).all()
    assert left[-1] < 0.2
    assert playback.moments[-1].end_reason == "success"
    assert len(playback.moments) <= 5


def test_actions_are_as_long_as_the_task_allows() -> None:
    choose = straight_to_target("ViTac/PegInsertion-v1")
    action = choose({}, {"gt_offset_mm_deg": np.array([-4.0, 1.0, 0.0])})
    assert action.dtype == np.float32
    assert action == pytest.approx([1.0, -0.25, 0.0])
    assert choose({}, {"gt_offset_mm_deg": np.array([-1.0, 0.0, 0.0])}) == pytest.approx([0.5, 0.0, 0.0])


@pytest.mark.parametrize("shape", ["key1", "key2", "key3", "key4"])
def test_key_comes_out_and_up_until_it_opens(fake_scenes: list[FakeScene], shape: str) -> None:
    env = LockOpeningEnv()
    options = {"shape": shape, "offset_mm": (3.0, 0.0, 0.0), "rng_seed": (0, 1)}
    playback = record(env, options=options, next_action=straight_to_target(env.env_id))
    assert playback.moments[-1].end_reason == "success"
    assert len(playback.moments) <= 7


def test_unknown_environment_is_refused() -> None:
    with pytest.raises(NotDrawable, match=r"No motion is known for ViTac/Other-v1; give actions or a policy"):
        straight_to_target("ViTac/Other-v1")
