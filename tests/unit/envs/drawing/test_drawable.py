import numpy as np
import pytest
from fake_scene import FakeScene
from vitac.envs.drawing.drawable import NotDrawable, straight_to_target
from vitac.envs.drawing.playback import record
from vitac.envs.tasks.lock_opening.env import LockOpeningEnv
from vitac.envs.tasks.peg_insertion.env import PegInsertionEnv


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
