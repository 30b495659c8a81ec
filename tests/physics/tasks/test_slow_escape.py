"""An IPC step whose every division ends at a saddle, and whose way out of it is longer than most."""

from typing import Any

import gymnasium
import numpy as np
import vitac.envs

START = {"rng_seed": (900, 120)}
ACTIONS = [
    [1, -0.52973402, 1],
    [0.40801638, 1, -1],
    [0.51114315, 0.60508692, -1],
    [-0.91142505, -0.18172485, -0.56487322],
    [1, -0.49172813, 0.30417413],
]


def test_crawling_escape_ends_at_a_solution() -> None:
    env: Any = gymnasium.make("ViTac/PegInsertion-v1", disable_env_checker=True, observation_keys=()).unwrapped
    assert env.env_id in vitac.envs.ENVIRONMENTS
    env.reset(options=START)
    assert env.task_scene.shape == "trapezoid"
    for action in ACTIONS:
        *_, info = env.step(np.array(action, dtype=np.float32))
    assert info["end_reason"] is None
    escaped = [report for report in info["step_reports"] if report.status == "escaped_saddle"]
    (report,) = escaped
    assert report.unstable_solutions > report.saddle_escapes > 0
    assert report.newton_iterations > 419, "as many as were made before it was given up"
    assert report.residual_n <= 1e-4
    assert report.smallest_det_f > 0.5
