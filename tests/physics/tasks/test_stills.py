"""Pictures of a running episode for videos."""

import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import gymnasium
import numpy as np
import pytest
import vitac.envs
from gymnasium.wrappers import RecordVideo, RenderCollection
from vitac.envs.scene.perspective import Plane
from vitac.envs.tasks.settings import SettingsError
from vitac.envs.tasks.task_env import NotRenderable, NotReset
from vitac.envs.vision.still import _cut_open

ENV_IDS = sorted(vitac.envs.ENVIRONMENTS)
PEG = "ViTac/PegInsertion-v1"
WHITE = 255


def made(env_id: str, render_mode: str | None = "rgb_array") -> Any:
    return gymnasium.make(
        env_id, render_mode=render_mode, observation_keys=("relative_motion",), disable_env_checker=True
    )


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


def test_task_without_a_perspective_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    env = made(PEG).unwrapped
    env.reset(seed=2)
    monkeypatch.setattr(env, "task", _Faceless())
    with pytest.raises(NotRenderable, match="PegInsertion-v1 has no perspective"):
        env.render()


class _Faceless:
    perspective = None
    env_id = PEG


def test_unknown_render_mode_is_refused() -> None:
    env_type = type(made(PEG).unwrapped)
    with pytest.raises(SettingsError, match="'render_mode' is 'human', expected None or rgb_array"):
        env_type(render_mode="human")


def test_frames_can_be_collected() -> None:
    env = RenderCollection(made(PEG))
    env.reset(seed=2)
    env.step(np.zeros(3, dtype=np.float32))
    assert len(env.render()) == 2


class KeptClip:
    """Stands in for the library that encodes videos: writes the size of the film in place of it."""

    def __init__(self, frames: list[np.ndarray], fps: int) -> None:
        self.told = f"{len(frames)} frames of {frames[0].shape}, {fps} each second"

    def write_videofile(self, path: str, **settings: Any) -> None:
        Path(path).write_text(self.told)


def test_gymnasium_records_a_video(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    encoder = ModuleType("moviepy.video.io.ImageSequenceClip")
    encoder.ImageSequenceClip = KeptClip  # type: ignore[attr-defined]
    for name in ("moviepy", "moviepy.video", "moviepy.video.io"):
        monkeypatch.setitem(sys.modules, name, ModuleType(name))
    monkeypatch.setitem(sys.modules, encoder.__name__, encoder)
    env = RecordVideo(made(PEG), str(tmp_path / "films"), episode_trigger=lambda _: True, disable_logger=True)
    env.reset(seed=2)
    for _ in range(2):
        env.step(np.zeros(3, dtype=np.float32))
    env.close()  # type: ignore[no-untyped-call]
    (video,) = tmp_path.glob("films/*.mp4")
    assert video.read_text() == "3 frames of (480, 640, 3), 4 each second"


def test_cut_open_surface_keeps_its_negative_side() -> None:
    corners = np.array([[-1.0, 0, 0], [1, 0, 0], [-1, 2, 0], [0, 3, 0], [2, 3, 0], [0, 4, 0]])
    triangles = np.array([[0, 1, 2], [3, 4, 5], [0, 1, 4]])
    points, kept = _cut_open(corners, triangles, Plane(normal=(1.0, 0.0, 0.0), offset_m=0.0))
    assert points[kept][..., 0].max() <= 0.0
    a, b, c = (points[kept][:, k] for k in range(3))
    areas = 0.5 * np.cross(b - a, c - a)[:, 2]
    assert (areas > 0).all(), "corners turn as they did, and nothing is left of the triangle that only touches"
    assert areas[:2].sum() == pytest.approx(2.0 * 0.75)
