from types import ModuleType
from typing import Any

import numpy as np
import pytest
from example_policies import flow

EXAMPLE = "soft_plug_scripted"


def observation(height_mm: float, *, pressed_px: float, turned_px: float = 0.0) -> dict[str, Any]:
    """Markers that rise, and turn by a slope of v per 100 pixels along u; in the other sensor by its opposite."""
    sensors = [flow(np.array([[pressed_px, 0.0], [0.0, side * turned_px], [0.0, 0.0]])) for side in (1.0, -1.0)]
    return {"marker_flow": np.stack(sensors), "relative_motion": np.array([0.0, 0.0, height_mm])}


def begun(policy: ModuleType) -> Any:
    player = policy.Policy()
    player.reset("soft-plug")
    return player


def test_goes_down_until_it_feels_the_plate(policy: ModuleType) -> None:
    player = begun(policy)
    assert player.act(observation(0.0, pressed_px=0.0)) == pytest.approx([0.0, 0.0, -0.8])
    assert player.act(observation(-0.8, pressed_px=2.0)) == pytest.approx([0.0, 0.0, -0.4])


@pytest.mark.parametrize("turned_px", [0.6, -0.6])
def test_moves_up_and_away_from_the_side_that_is_supported(policy: ModuleType, turned_px: float) -> None:
    player = begun(policy)
    x, y, z = player.act(observation(-1.2, pressed_px=5.0, turned_px=turned_px))
    further = player.act(observation(-0.2, pressed_px=0.0))
    assert x + further[0] == pytest.approx(-policy.X_MM[0] * 2.0 * turned_px, rel=1e-4)
    assert (y, z) == pytest.approx((0.0, 1.0), abs=1e-4)


def test_pushes_on_where_the_plug_has_sunk_in(policy: ModuleType) -> None:
    assert begun(policy).act(observation(-2.4, pressed_px=5.0)) == pytest.approx([0.0, 0.0, -1.0])
