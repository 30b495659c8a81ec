from types import ModuleType
from typing import Any

import numpy as np
import pytest
from example_policies import flow

EXAMPLE = "cable_end_scripted"


def observation(height_mm: float, *, pressed_px: float, turned_px: float = 0.0) -> dict[str, Any]:
    """Markers that rise, and turn by a slope of v per 100 pixels along u; in the other sensor by its opposite."""
    sensors = [flow(np.array([[pressed_px, 0.0], [0.0, side * turned_px], [0.0, 0.0]])) for side in (1.0, -1.0)]
    return {"marker_flow": np.stack(sensors), "relative_motion": np.array([0.0, 0.0, height_mm])}


def pressed(policy: ModuleType, *, pressed_px: float, turned_px: float = 0.0) -> tuple[Any, Any]:
    """Return the policy after three presses, and its action then."""
    player = policy.Policy()
    player.reset("cable-end")
    heights_mm = []
    for height_mm in (0.0, *policy.PRESSES_MM[:-1]):
        x, y, z = player.act(observation(height_mm, pressed_px=pressed_px, turned_px=turned_px))
        heights_mm.append(height_mm + z)
        assert (x, y) == (0.0, 0.0)
    assert heights_mm == pytest.approx(policy.PRESSES_MM)
    return player, player.act(observation(policy.PRESSES_MM[-1], pressed_px=pressed_px, turned_px=turned_px))


@pytest.mark.parametrize("turned_px", [0.3, -0.3])
def test_moves_up_and_away_from_the_side_that_is_supported(policy: ModuleType, turned_px: float) -> None:
    player, (x, y, z) = pressed(policy, pressed_px=2.0, turned_px=turned_px)
    further = player.act(observation(-0.4, pressed_px=0.0))
    assert x + further[0] == pytest.approx(-policy.X_MM[0] * 2.0 * turned_px, rel=1e-4)
    assert (y, z) == pytest.approx((0.0, 1.0), abs=1e-4)


def test_pushes_on_where_nothing_presses_back(policy: ModuleType) -> None:
    player, action = pressed(policy, pressed_px=0.3)
    assert action == pytest.approx([0.0, 0.0, -1.0])
    assert player.act(observation(-3.0, pressed_px=5.0)) == pytest.approx([0.0, 0.0, -1.0])
