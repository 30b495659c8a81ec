"""The exploring task in the physics: what touches is what is above the pin, and the example feels it."""

from pathlib import Path
from runpy import run_path

import numpy as np
import pytest
from vitac.envs.tasks.explore.definition import EndShape
from vitac.envs.tasks.explore.env import ExploreEnv, touch_around

TOUCHES_N = 1.0


@pytest.mark.parametrize("shape", list(EndShape))
def test_forces_and_markers_say_where_the_end_is(shape: EndShape, repository: Path) -> None:
    policy = run_path(str(repository / "examples" / "explore_scripted" / "Explore" / "policy.py"))
    env = ExploreEnv(privileged=True)
    observation, info = env.reset(options={"shape": shape, "end_pose_mm_deg": (0.0, 0.0, 0.0), "rng_seed": (5, 1)})
    expected = [bool(felt) for felt in policy["FELT"][shape]]
    pressed, felt = [], []
    while info["end_reason"] is None:
        pressed.append(bool(observation["contact_forces"][0, 2] > TOUCHES_N))
        before, after = observation["marker_flow"].swapaxes(0, 1)
        felt.append(bool(np.abs(after - before).mean() > policy["TOUCHED_PX"]))
        observation, *_, info = env.step(touch_around(observation, info))
    assert info["is_success"]
    assert (pressed, felt) == (expected, expected)
