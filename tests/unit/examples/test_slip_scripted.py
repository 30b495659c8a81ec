from types import ModuleType
from typing import Any

import numpy as np
import pytest

FRICTION, WEIGHT_N = 0.6, 2.4


EXAMPLE = "slip_scripted"


def seen(policy: ModuleType, pull_n: float, width_mm: float, height_mm: float) -> dict[str, Any]:
    """What is observed of gels that are sheared by a pull, and spread by the grip."""
    random = np.random.default_rng(1)
    before = random.uniform((20, 20), (300, 220), (2, 60, 2))
    shift_px = (pull_n - policy.PULL_N) / policy.PULL_N_PX
    after = before + np.array([shift_px, 0.3]) + 0.004 * (before - np.array([160.0, 120.0]))
    flow = np.stack([before, after], axis=1)
    return {
        "marker_flow": np.concatenate([flow, np.repeat(flow[:, :, -1:], 68, axis=2)], axis=2),
        "gripper_width": np.array([width_mm]),
        "relative_motion": np.array([height_mm]),
    }


def test_feels_the_pull_whatever_the_grip_spreads(policy: ModuleType) -> None:
    for pull in (0.5, 2.0, 9.0):
        assert policy.pull_n(seen(policy, pull, 30.1, 0.0)["marker_flow"]) == pytest.approx(pull, abs=1e-6)


def test_width_and_grip_follow_from_each_other(policy: ModuleType) -> None:
    for grip in (0.6, 1.1, 4.0, 12.0):
        assert policy.grip_n(policy.width_mm(grip)) == pytest.approx(grip, rel=1e-6)


def test_lifts_ever_harder_until_the_part_hangs_and_follows_its_load(policy: ModuleType) -> None:
    """A part that slides at twice the friction times the grip, and a load that grows by 1 N an env step."""
    player = policy.Policy()
    player.reset("slip")
    width, height, pull, grips = policy.TOUCHING_MM, 0.0, 0.0, []
    for env_step in range(1, 17):
        action = player.act(seen(policy, pull, width, height))
        height, width = height + float(action[0]), width + policy.WIDTH_MM * float(action[1])
        grips.append(policy.grip_n(width))
        load = WEIGHT_N + max(0.0, env_step - 7.0)
        pull = min(load, 2.0 * FRICTION * grips[-1])
    assert grips[:3] == pytest.approx(policy.GRIPS_N[:3])
    for env_step, pull in ((7, WEIGHT_N), (8, WEIGHT_N + policy.FASTEST_N), (16, WEIGHT_N + 9.0)):
        needed = pull / (2.0 * FRICTION)
        assert grips[env_step - 1] == pytest.approx(policy.MARGIN * needed, rel=0.15)
    sets_down = player.act(seen(policy, WEIGHT_N + 9.0, width, height))
    assert sets_down[0] < 0.0
    assert sets_down[1] == 0.0
    lets_go = player.act(seen(policy, 0.5, width, height - 1.0))
    assert lets_go.tolist() == [0.0, 1.0]
