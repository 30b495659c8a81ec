"""What the example gives to LeRobot's policy is what the data set has; `test_writing` trains one for a step."""

from pathlib import Path
from runpy import run_path

import numpy as np
from example_policies import flow
from vitac.training.demonstrations.lerobot.layout import fit_motions


def test_observations_are_those_of_the_data_set_and_a_blind_policy_feels_nothing(repository: Path) -> None:
    observe = run_path(str(repository / "examples" / "lerobot_act" / "play.py"))["observe"]
    gels = np.stack([flow(np.array([[2.9, 0], [0.4, -0.1], [0, 0.2]]), 0.5, seed) for seed in (1, 2)])
    observation = {"marker_flow": gels, "relative_motion": np.array([1.0, 0.0, -2.0], np.float32)}
    seen, blind = observe(observation, is_blind=False), observe(observation, is_blind=True)
    np.testing.assert_allclose(seen["observation.environment_state"], fit_motions(gels[None])[0], atol=1e-5)
    assert np.abs(seen["observation.environment_state"]).max() > 0.1
    assert not blind["observation.environment_state"].any()
    assert (seen["observation.state"] == blind["observation.state"]).all()
