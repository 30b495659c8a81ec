from dataclasses import replace

import numpy as np
import pytest
from vitac.envs.drawing.colouring import Quantity, colouring, round_limits
from vitac.envs.drawing.playback import Playback


@pytest.mark.parametrize(
    ("low", "high", "expected"),
    [
        (0.0, 0.0, (0.0, 1.0)),
        (0.0, 87.0, (0.0, 90.0)),
        (12.3, 19.1, (12.0, 20.0)),
        (0.013, 0.94, (0.0, 1.0)),
        (0, 1, (0, 1)),
    ],
)
def test_limits_are_round_and_hold_the_range(low: float, high: float, expected: tuple[float, float]) -> None:
    assert round_limits(low, high) == pytest.approx(expected)


def test_displacement_is_in_millimetres(peg_playback: Playback) -> None:
    found = colouring(peg_playback, Quantity.DISPLACEMENT)
    assert found.label == "displacement [mm]"
    assert len(found.values) == len(peg_playback.moments)
    for gel in found.values[-1]:
        assert gel[peg_playback.gel.sensing] == pytest.approx(0.6)
        assert gel[peg_playback.gel.driven] == pytest.approx(0.0, abs=1e-9)
    assert (found.lowest, found.highest) == pytest.approx((0.0, 0.6))


def test_stress_of_a_pressed_gel_is_that_of_confined_compression(peg_playback: Playback) -> None:
    found = colouring(peg_playback, Quantity.STRESS)
    assert found.label == "von Mises stress [kPa]"
    stretch = (4.0 - 0.6) / 4.0
    mu_kpa = 300.0 / 2.6
    expected = abs(mu_kpa * (stretch**2 - 1) / stretch)
    middle = np.abs(peg_playback.gel.rest_position_m[:, :2]).max(axis=1) < 1e-6
    for gel in found.values[0]:
        assert gel[middle] == pytest.approx(expected)
    assert found.lowest <= expected <= found.highest


def test_one_scale_fits_all_moments(peg_playback: Playback) -> None:
    whole = colouring(peg_playback, Quantity.STRESS)
    alone = colouring(replace(peg_playback, moments=peg_playback.moments[:1]), Quantity.STRESS)
    assert whole.lowest <= alone.lowest
    assert whole.highest >= alone.highest
