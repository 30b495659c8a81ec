import pytest
from fake_scene import FakeScene
from vitac.envs.drawing.drawable import straight_to_target
from vitac.envs.drawing.playback import EpisodePlayback, record
from vitac.envs.tasks.peg_insertion.env import PegInsertionEnv

PEG_OPTIONS = {"shape": "trapezoid", "offset_mm_deg": (-3.0, 1.5, 6.0), "rng_seed": (0, 5)}


@pytest.fixture
def peg_playback(fake_scenes: list[FakeScene], monkeypatch: pytest.MonkeyPatch) -> EpisodePlayback:
    """A peg that goes into its hole, with gels that are pressed in by a fake of the physics."""
    monkeypatch.setattr(FakeScene, "bulge_m", -6e-4)
    env = PegInsertionEnv()
    return record(env, options=PEG_OPTIONS, next_action=straight_to_target(env.env_id))
