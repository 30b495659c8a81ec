"""What the sensors of a gripper read of a part that hangs in the grasp under a growing load."""

from typing import Any

import gymnasium
import numpy as np
import pytest
from numpy.typing import NDArray
from vitac.envs.tasks.slip.env import lift_ever_harder

FloatArray = NDArray[np.float64]


@pytest.fixture(scope="module")
def hanging() -> list[tuple[dict[str, FloatArray], dict[str, Any]]]:
    """Observation and info after each env step in which the part hangs, grasped 1.5 mm beside its centre of mass."""
    env: Any = gymnasium.make(
        "ViTac/Slip-v1",
        disable_env_checker=True,
        privileged=True,
        optional_observables=("wrist_wrench", "taxel_forces"),
    ).unwrapped
    observation, info = env.reset(options={"shape": "block", "offset_mm": (1.5, 0.0), "rng_seed": (0, 1)})
    steps = []
    for number in range(1, 19):
        observation, *_, info = env.step(lift_ever_harder(observation, info))
        assert info["end_reason"] is None
        if number >= 7:
            steps.append((observation, info))
    return steps


def test_the_wrist_reads_weight_and_load_and_the_moment_of_both(
    hanging: list[tuple[dict[str, FloatArray], dict[str, Any]]],
) -> None:
    wrenches = np.array([observation["wrist_wrench"] for observation, _ in hanging])
    pulled_n = np.array([observation["part_properties"][0] * 9.81 + info["load_n"] for observation, info in hanging])
    assert pulled_n.max() > 10.0
    # The noise is 0.1 N, and a part that still moves is held by up to 0.03 N more or less.
    np.testing.assert_allclose(wrenches[:, 2], -pulled_n, atol=0.45)
    np.testing.assert_allclose(wrenches[:, :2], 0.0, atol=0.4)
    # The part pulls 1.5 mm beside the middle of the gripper, in the plane of the gels.
    np.testing.assert_allclose(wrenches[:, 4], -1.5e-3 * pulled_n, atol=0.02)
    np.testing.assert_allclose(wrenches[:, [3, 5]], 0.0, atol=0.02)


def test_taxels_add_up_to_grip_and_load(
    hanging: list[tuple[dict[str, FloatArray], dict[str, Any]]],
) -> None:
    for observation, info in hanging:
        felt_n = observation["taxel_forces"].sum(axis=(1, 2))
        np.testing.assert_allclose(felt_n[:, 2], info["grip_force_n"], atol=0.3)
        pulled_n = observation["part_properties"][0] * 9.81 + info["load_n"]
        # u points up on both gels, and each carries a half.
        np.testing.assert_allclose(felt_n[:, 0], -0.5 * pulled_n, atol=0.3)
        np.testing.assert_allclose(felt_n[:, 1], 0.0, atol=0.3)
