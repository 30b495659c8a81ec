"""What is measured before a trial, and while the peg hangs in free air."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from vitac.station.devices.force_torque import Wrench
from vitac.station.devices.gripper import Grasp, GripperStatus
from vitac.station.devices.stage import GrblState
from vitac.station.perception.markers import MarkerFlow
from vitac.station.preflight import PreflightRefused, check_held, check_ready


def station(wrench: Wrench | None, markers: int = 63, grasp: Grasp = Grasp.AT_POSITION) -> Any:
    flow = MarkerFlow(np.zeros((markers, 2)), np.zeros((markers, 2)))
    status = GripperStatus(is_activated=True, grasp=grasp, fault=0, request=255, position=180, current=0)
    camera = SimpleNamespace(calibration=SimpleNamespace(markers=63))
    return SimpleNamespace(
        guard=SimpleNamespace(wrench=lambda: wrench),
        eyes=SimpleNamespace(see=lambda: SimpleNamespace(left=flow, right=flow)),
        gripper=SimpleNamespace(status=lambda: status),
        stage=SimpleNamespace(status=lambda: SimpleNamespace(state=GrblState.IDLE)),
        procedure=SimpleNamespace(zero_n=2.0, zero_nm=0.1, free_gb=0.0),
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


def test_gels_are_judged_before_a_trial_unless_a_part_is_between_them(tmp_path: Path) -> None:
    """An agent that was killed in a contact leaves its part there, and its trial must begin."""
    with pytest.raises(PreflightRefused, match="Left gel: expected at least 90% of 63 markers, got 48 markers"):
        check_ready(station(None, 48), tmp_path)
    check_ready(station(None, 48, Grasp.MET_OBJECT_CLOSING), tmp_path)
