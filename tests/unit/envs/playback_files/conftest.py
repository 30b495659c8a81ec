import pytest
from fake_scene import FakeScene
from vitac.envs.drawing.drawable import straight_to_target
from vitac.envs.drawing.playback import EpisodePlayback, Pace, record
from vitac.envs.tasks.fusion_insertion.env import FusionInsertionEnv
from vitac.envs.tasks.peg_insertion.env import PegInsertionEnv


@pytest.fixture
def peg_playback(fake_scenes: list[FakeScene], monkeypatch: pytest.MonkeyPatch) -> EpisodePlayback:
    """A peg that goes into its hole, with gels that are pressed in by a fake of the physics."""
    monkeypatch.setattr(FakeScene, "bulge_m", -6e-4)
    env = PegInsertionEnv()
    options = {"shape": "trapezoid", "offset_mm_deg": (-3.0, 1.5, 6.0), "rng_seed": (0, 5)}
    return record(env, options=options, next_action=straight_to_target(env.env_id), pace=Pace.IPC_STEP)


@pytest.fixture
def fusion_playback(fake_scenes: list[FakeScene]) -> EpisodePlayback:
    """Two env steps of a peg that cameras look at."""
    env = FusionInsertionEnv(max_steps=2)
    options = {"start": (0.0, 0.0, 0.0, 3.0, 1), "rng_seed": (0, 1)}
    return record(env, options=options, next_action=straight_to_target(env.env_id), pace=Pace.IPC_STEP)
