from types import ModuleType
from typing import Any

import numpy as np
import pytest

EXAMPLE = "in_hand_turn_scripted"


def observation(x_mm: float, twist_deg: float) -> dict[str, Any]:
    """The markers of gels that a rod has twisted: in their pictures u is up, v to opposite sides."""
    random = np.random.default_rng(1)
    sine, cosine = np.sin(np.radians(twist_deg)), np.cos(np.radians(twist_deg))
    sensors = []
    for right in (-1.0, 1.0):
        up, along = random.uniform(-80, 80, (2, 60))
        turned = np.stack([cosine * up - sine * along, right * (cosine * along + sine * up)], axis=1)
        sensors.append(np.stack([np.stack([up, right * along], axis=1), turned + np.array([3.0, 2.0 * right])]))
    motion = np.array([x_mm, 0.0])
    return {"marker_flow": np.stack(sensors), "relative_motion": motion, "goal_angle": np.array([20.0])}


def test_measures_the_twist_of_the_gels_whatever_else_moves_them(policy: ModuleType) -> None:
    for twist in (-3.0, 0.0, 6.0):
        assert policy.twist_deg(observation(0.0, twist)["marker_flow"]) == pytest.approx(twist, abs=0.02)


def test_searches_until_the_gels_are_twisted_and_presses_only_until_the_rod_would_turn_back_to_its_goal(
    policy: ModuleType,
) -> None:
    player = policy.Policy()
    player.reset("in-hand-turn")
    assert player.act(observation(0.0, 0.1)) == pytest.approx([0.6, 0.0])
    assert player.act(observation(3.0, 0.2)) == pytest.approx([0.6, 0.0])
    x_mm, ways = 6.0, []
    for _ in range(12):
        action = player.act(observation(x_mm, 5.0))
        x_mm += 5.0 * float(action[0])
        ways.append(float(action[0]))
    assert ways[0] > ways[5] > ways[-1] >= 0.0
    pressed = 20.0 + policy.RETURNED * 5.0
    gone_mm = policy.LEVER_MM * np.tan(np.radians(pressed)) + policy.ASIDE_MM
    assert x_mm == pytest.approx(3.0 + gone_mm, abs=0.2)
    assert player.act(observation(x_mm + 5.0, 5.0)).tolist() == [0.0, 0.0], "nothing turns it back"
