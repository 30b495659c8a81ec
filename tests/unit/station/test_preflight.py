"""What is measured while the peg hangs in free air."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from vitac.station.devices.force_torque import Wrench
from vitac.station.perception.tracker import MarkerFlow
from vitac.station.preflight import PreflightRefused, check_held


def station(wrench: Wrench | None, markers: int = 63) -> Any:
    flow = MarkerFlow(np.zeros((markers, 2)), np.zeros((markers, 2)))
    camera = SimpleNamespace(calibration=SimpleNamespace(markers=63))
    return SimpleNamespace(
        guard=SimpleNamespace(wrench=lambda: wrench),
        eyes=SimpleNamespace(see=lambda: SimpleNamespace(left=flow, right=flow)),
        procedure=SimpleNamespace(zero_n=2.0, zero_nm=0.1),
        description=SimpleNamespace(left=camera, right=camera),
    )


def test_peg_in_free_air_is_ready_for_the_descent() -> None:
    assert all(finding.is_good for finding in check_held(station(Wrench(0.5, 0.0, -0.6, 0.0, 0.02, 0.0))))


@pytest.mark.parametrize(
    ("wrench", "markers", "sentence"),
    [
        (
            Wrench(0.0, 0.0, 2.1, 0.0, 0.0, 0.0),
            63,
            "expected at most 2.0 N and 0.1 N m with nothing touched, got 2.10 N",
        ),
        (Wrench(0.0, 0.0, 0.0, 0.0, 0.2, 0.0), 63, r"got 0.00 N and 0.200 N m"),
        (None, 63, "got inf N"),
        (Wrench(0.0, 0.0, 0.0, 0.0, 0.0, 0.0), 50, "Left gel: expected at least 90% of 63 markers, got 50 markers"),
    ],
)
def test_wrong_zero_and_a_gel_without_its_markers_are_refused(
    wrench: Wrench | None, markers: int, sentence: str
) -> None:
    with pytest.raises(PreflightRefused, match=sentence):
        check_held(station(wrench, markers))
