"""Pictures of a running episode for videos."""

from dataclasses import replace
from typing import Any

import gymnasium
import numpy as np
import pytest
import vitac.envs
from vitac.envs.tasks.peg_insertion.env import PegInsertionEnv
from vitac.envs.tasks.task_env import NotRenderable, NotReset

ENV_IDS = sorted(vitac.envs.ENVIRONMENTS)
PEG = "ViTac/PegInsertion-v1"
WHITE = 255


def made(env_id: str, render_mode: str | None = "rgb_array") -> Any:
    return gymnasium.make(env_id, render_mode=render_mode, observation_keys=("marker_flow",), disable_env_checker=True)


def kinds(picture: np.ndarray) -> dict[str, int]:
    """Pixels by what they show."""
    red, green, blue = (picture[..., k].astype(int) for k in range(3))
    return {
        "held": int(((red > 200) & (green < 100) & (blue < 100)).sum()),
        "fixed": int(((red < 100) & (blue > 200)).sum()),
        "gels": int(((red > 100) & (red < 200) & (green > 200)).sum()),
        "nothing": int((picture == WHITE).all(axis=-1).sum()),
    }


@pytest.mark.parametrize("env_id", ENV_IDS)
def test_picture_shows_all_parts_with_room_around_them(env_id: str) -> None:
    env = made(env_id)
    env.reset(seed=1)
    picture = env.render()
    assert (picture.shape, picture.dtype) == ((480, 640, 3), np.uint8)
    found = kinds(picture)
    assert sum(found.values()) == 480 * 640
    assert min(found.values()) > 1000
    border = np.concatenate([picture[0], picture[-1], picture[:, 0], picture[:, -1]])
    assert (border == WHITE).all()


def test_picture_follows_the_motion_and_the_camera_stands_still() -> None:
    env = made(PEG)
    env.reset(seed=1)
    before = env.render()
    np.testing.assert_array_equal(before, env.render())
    env.step(np.array([1, 0, 0], dtype=np.float32))
    after = env.render()
    changed = (before != after).any(axis=-1)
    assert 500 < changed.sum() < 100_000
    lowest = np.flatnonzero((before != WHITE).any(axis=(1, 2))).max()
    np.testing.assert_array_equal(before[lowest], after[lowest], err_msg="the plate does not move")


def test_next_episode_has_a_camera_of_its_own() -> None:
    env = made(PEG)
    env.reset(options={"shape": "cuboid", "offset_mm_deg": (-4, -4, -8), "rng_seed": 1})
    first = env.render()
    env.reset(options={"shape": "concave1", "offset_mm_deg": (4, 4, 8), "rng_seed": 1})
    assert (env.render() != first).any()
    env.reset(options={"shape": "cuboid", "offset_mm_deg": (-4, -4, -8), "rng_seed": 1})
    np.testing.assert_array_equal(env.render(), first)


def test_pictures_change_nothing_of_the_episode() -> None:
    seen, plain = made(PEG), made(PEG, render_mode=None)
    for env in (seen, plain):
        env.reset(seed=2)
        env.render()
        env.step(np.ones(3, dtype=np.float32))
    assert seen.unwrapped.state_hash() == plain.unwrapped.state_hash()


def test_no_picture_without_a_render_mode() -> None:
    env = made(PEG, render_mode=None)
    env.reset(seed=2)
    assert env.unwrapped.render() is None


def test_no_picture_before_the_first_reset() -> None:
    with pytest.raises(NotReset):
        made(PEG).unwrapped.render()


def test_task_without_a_perspective_has_no_render_mode() -> None:
    class Faceless(PegInsertionEnv):
        task = replace(PegInsertionEnv.task, perspective=None)

    assert Faceless.metadata["render_modes"] == []
    assert PegInsertionEnv.metadata["render_modes"] == ["rgb_array"]
    with pytest.raises(NotRenderable, match="PegInsertion-v1 has no perspective"):
        Faceless(render_mode="rgb_array")
