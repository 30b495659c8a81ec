from types import ModuleType
from typing import Any

import numpy as np
import pytest

EXAMPLE = "assembly_scripted"


def observation(motion: Any, width_mm: float = 29.7, x_px: float = 0.0) -> dict[str, Any]:
    """The markers of gels that a head presses on at a place along x: there they spread up and down."""
    up, along = (axis.ravel() for axis in np.meshgrid(np.linspace(40, 280, 9), np.linspace(20, 230, 8)))
    sensors = []
    for side in (-1.0, 1.0):
        spread = np.exp(-0.5 * ((side * (along - 125.0) - x_px) / 30.0) ** 2)
        before = np.stack([up, along], axis=1)
        sensors.append(np.stack([before, np.stack([up + 0.02 * spread * (up - 160.0), along], axis=1)]))
    return {
        "marker_flow": np.stack(sensors),
        "relative_motion": np.array(motion, dtype=np.float64),
        "gripper_width": np.array([width_mm]),
    }


def test_a_part_that_is_held_further_along_is_felt_further_along(policy: ModuleType) -> None:
    def felt_mm(x_px: float) -> float:
        seen = policy.features(observation([0, 0, 0, 0], x_px=x_px)["marker_flow"])[0]
        return float(seen @ policy.WEIGHTS[0, :-1] + policy.WEIGHTS[0, -1])

    assert felt_mm(-40.0) + 2.0 < felt_mm(0.0) < felt_mm(40.0) - 2.0


def test_closes_then_lifts_carries_lowers_and_turns_the_part_about_its_own_axis(policy: ModuleType) -> None:
    player = policy.Policy()
    player.reset("assembly")
    assert player.act(observation([0, 0, 0, 0], width_mm=36.0)) == pytest.approx([0, 0, 0, 0, -1])
    assert player.act(observation([0, 0, 0, 0], width_mm=30.0)) == pytest.approx([0, 0, 0, 0, -0.15])
    player.held = np.array([2.0, 5.0])
    now, way = np.zeros(4), []
    for _ in range(30):
        now = now + policy.STEP * player.act(observation(now))[:4]
        angle = np.radians(now[3])
        way.append([now[0] + 2.0 * np.cos(angle), now[1] + 2.0 * np.sin(angle), now[2], now[3] + 5.0])
    part = np.array(way)
    low = part[:, 2] < 4.0
    low[:2] = False  # before it is lifted
    assert part[~low][-1] == pytest.approx([26.0, 0.0, 4.1, 0.0], abs=0.05), "over the socket and straight"
    assert np.abs(part[low, :2] - [26.0, 0.0]).max() < 0.05, "turned about its own axis"
    assert part[-1] == pytest.approx([26.0, 0.0, -4.9, 60.0], abs=0.05)
