"""Pictures of an episode, on the stand-in for ManiSkill."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest
from fake_pick_cube import FakePickCube, in_place_of_maniskill
from numpy.typing import NDArray
from vitac.envs.maniskill.env import ManiSkillEnv, ManiSkillFailed
from vitac.envs.maniskill.film import MAX_PICTURES, FilmMoment, Shot, captioned, play, select_env_steps, shots

START = {"shape": "drawn", "variant": (0.0,), "rng_seed": (0, 1)}


@pytest.fixture
def fake(monkeypatch: pytest.MonkeyPatch) -> FakePickCube:
    return in_place_of_maniskill(monkeypatch)


def made(max_steps: int = 5) -> ManiSkillEnv:
    return ManiSkillEnv("ManiSkill/PickCube-v1", max_steps=max_steps, draws=True)


def hold(observation: Mapping[str, NDArray[Any]], info: Mapping[str, Any]) -> NDArray[np.float32] | None:
    """Stops the episode after four env steps by itself."""
    assert observation["state"][0] == info["steps"]
    return None if info["steps"] == 4 else np.zeros(7, np.float32)


def drawn(every: int, max_steps: int = 5) -> list[Shot]:
    env = made(max_steps)
    return list(shots(env, play(env, options=START, next_action=hold), lambda env_step: env_step % every == 0))


def test_an_episode_is_played_to_its_end_or_to_the_last_action(fake: FakePickCube) -> None:
    moments = list(play(made(), options=START, next_action=hold))
    assert [moment.env_step for moment in moments] == [0, 1, 2, 3, 4]
    assert [moment.total_reward for moment in moments] == [0, 0.25, 0.5, 0.75, 1]
    assert {moment.end_reason for moment in moments} == {None}
    *_, last = play(made(max_steps=3), options=START, next_action=hold)
    assert (last.env_step, last.end_reason) == (3, "steps")
    assert last.sentence == "env step 3, reward 0.75, steps"
    fake.solves = True
    *_, last = play(made(), options=START, next_action=hold)
    assert (last.env_step, last.end_reason) == (3, "success")


def test_an_episode_without_actions_is_its_start(fake: FakePickCube) -> None:
    (moment,) = play(made(), options=START, next_action=lambda _, __: None)
    assert moment == FilmMoment(env_step=0, total_reward=0.0, end_reason=None)
    assert fake.commands == []


@pytest.mark.parametrize(("every", "steps"), [(1, [0, 1, 2, 3, 4]), (2, [0, 2, 4]), (3, [0, 3, 4]), (9, [0, 4])])
def test_the_last_moment_is_always_drawn_and_once(fake: FakePickCube, every: int, steps: list[int]) -> None:
    found = drawn(every)
    assert [shot.moment.env_step for shot in found] == steps
    # The stand-in's picture has a bright stripe that grows with the env steps.
    assert [int((shot.picture[0, :, 0] > 0).sum()) for shot in found] == [8 * (step + 1) for step in steps]
    assert {(shot.picture.shape, str(shot.picture.dtype)) for shot in found} == {((64, 96, 3), "uint8")}


@pytest.mark.parametrize("max_steps", [1, 50, 99, 100, 101, 500, 999])
def test_the_longest_episode_has_no_more_pictures_than_an_animation_may(max_steps: int) -> None:
    every = select_env_steps(max_steps)
    pictures = 1 + -(-max_steps // every)
    assert pictures <= MAX_PICTURES + 1
    assert every == 1 or 2 * pictures > MAX_PICTURES


def test_a_caption_stands_above_and_below_the_picture_and_leaves_it_whole(fake: FakePickCube) -> None:
    shot = drawn(9)[-1]
    sheet = captioned(shot, "Pick a cube, episode 1", 480)
    height, width, _ = sheet.shape
    line = (height - 320) // 2
    assert (width, line > 20) == (480, True)
    scene, below = sheet[line:-line], sheet[-line:]
    assert (sheet[:line].min() < 100, below.min() < 100) == (True, True), "text is dark"
    assert abs(float(scene[160, 20, 0]) - 200) < 5
    assert scene[160, 460].tolist() == [0, 0, 0]
    other = captioned(drawn(9)[0], "Pick a cube, episode 1", 480)
    assert (other[:line] == sheet[:line]).all()
    assert (other[-line:] != below).any()


def test_a_title_that_is_too_long_is_cut_at_the_edge(fake: FakePickCube) -> None:
    shot = drawn(9)[0]
    assert (captioned(shot, "x" * 500, 480) == captioned(shot, "x" * 80, 480)).all()


def test_what_the_driver_cannot_draw_is_named_as_the_environments_failure(
    fake: FakePickCube, monkeypatch: pytest.MonkeyPatch
) -> None:
    def lost() -> None:
        raise RuntimeError("ErrorDeviceLost")

    monkeypatch.setattr(fake, "render", lost)
    with pytest.raises(ManiSkillFailed, match="PickCube-v1 failed in picture at env step 0: RuntimeError: ErrorDevice"):
        drawn(1)
