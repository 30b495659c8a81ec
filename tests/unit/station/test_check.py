"""`check_station` names what is wrong with each device of a station of twins."""

from collections.abc import Callable
from contextlib import nullcontext
from threading import Event
from typing import Any

import numpy as np
import pytest
from vitac.evaluator.strict_model import validate
from vitac.station.check import DeviceRule, check_station
from vitac.station.description import StationDescription
from vitac.station.devices.cameras import ColourIntrinsics
from vitac.station.devices.gripper import HandE
from vitac.station.devices.stage import Identity, LinearStage
from vitac.station.twin.force_torque import ForceTorqueFault
from vitac.station.twin.gel_view import SMALL_CAMERA, marker_grid
from vitac.station.twin.gripper import GripperFault
from vitac.station.twin.laboratory import TwinStation


def problems(twins: TwinStation) -> dict[str, list[tuple[DeviceRule, str]]]:
    described = validate(StationDescription, twins.description, "station.yaml")
    return {
        each.device: [(problem.rule, problem.sentence) for problem in each.problems]
        for each in check_station(described)
        if each.problems
    }


def test_station_as_described_has_no_problems(twins: TwinStation) -> None:
    assert problems(twins) == {}


def other_serial_number(twins: TwinStation) -> None:
    twins.stage.serial_number = "STAGE-2"


def other_firmware(twins: TwinStation) -> None:
    twins.stage.firmware = "1.1f.20170801"


def other_steps(twins: TwinStation) -> None:
    twins.stage.settings[102] = 800.0


def slow_brakes(twins: TwinStation) -> None:
    twins.stage.settings[121] = 100.0


def no_homing(twins: TwinStation) -> None:
    twins.stage.settings[22] = 0.0


def stage_unplugged(twins: TwinStation) -> None:
    twins.lines["stage"].unplug()


def other_gel(twins: TwinStation) -> None:
    twins.description["left"]["calibration"]["serial_number"] = "2871-46HU"


def worn_gel(twins: TwinStation) -> None:
    generator = np.random.default_rng(1)
    few = marker_grid()[:50]
    twins.right.picture = lambda: SMALL_CAMERA.picture(few, generator)


def camera_unplugged(twins: TwinStation) -> None:
    twins.description["right"]["stream"] = None


def other_sensor_at_the_box(twins: TwinStation) -> None:
    twins.force_torque.decoupling[1][2] = 3.5


def frozen_box(twins: TwinStation) -> None:
    twins.force_torque.faults.add(ForceTorqueFault.FROZEN)


def gripper_fault(twins: TwinStation) -> None:
    twins.gripper.faults.add(GripperFault.OVERCURRENT)


@pytest.mark.parametrize(
    ("spoil", "device", "rule", "sentence"),
    [
        (other_serial_number, "stage", DeviceRule.SERIAL_NUMBER, "Expected serial number STAGE-1, got STAGE-2."),
        (other_firmware, "stage", DeviceRule.FIRMWARE, "Expected firmware 1.1h.20190825, got 1.1f.20170801."),
        (
            other_steps,
            "stage",
            DeviceRule.CALIBRATION,
            "steps of z: expected 400.0 as in the file, the device has 800.0.",
        ),
        (slow_brakes, "stage", DeviceRule.LIMITS, "y must stop in 10 ms: expected $121 of at least 300, got 100."),
        (no_homing, "stage", DeviceRule.LIMITS, "The stage has no homing: set $22=1."),
        (stage_unplugged, "stage", DeviceRule.FOUND, "No stage at /"),
        (
            other_gel,
            "left tactile camera",
            DeviceRule.CALIBRATION,
            "calibration is of 2871-46HU, expected one of 28F0-GX7F.",
        ),
        (worn_gel, "right tactile camera", DeviceRule.CALIBRATION, "Expected 63 markers on the gel, got 50."),
        (camera_unplugged, "right tactile camera", DeviceRule.FOUND, "No camera has the serial number 28W2-TRN5."),
        (other_sensor_at_the_box, "force/torque sensor", DeviceRule.CALIBRATION, "decoupling matrix of another sensor"),
        (frozen_box, "force/torque sensor", DeviceRule.WORKS, "stopped answering"),
        (gripper_fault, "gripper", DeviceRule.WORKS, "reports fault 0x0E: overcurrent"),
    ],
)
def test_names_what_is_wrong_with_one_device_and_nothing_else(
    twins: TwinStation, spoil: Callable[[TwinStation], None], device: str, rule: DeviceRule, sentence: str
) -> None:
    spoil(twins)
    found = problems(twins)
    assert list(found) == [device]
    assert [each[0] for each in found[device]] == [rule]
    assert sentence in found[device][0][1]


@pytest.mark.parametrize(("patience", "devices"), [(1.0, ["stage", "force/torque sensor"]), (1e4, [])])
def test_devices_that_answer_late_need_the_patience_of_the_file(
    twins: TwinStation, monkeypatch: pytest.MonkeyPatch, patience: float, devices: list[str]
) -> None:
    def delay(answer: Callable[[Any], bytes]) -> Callable[[Any], bytes]:
        return lambda asked: (Event().wait(0.05), answer(asked))[1]

    for name in ("stage", "force_torque"):
        monkeypatch.setattr(f"vitac.station.devices.{name}._ANSWER_S", 0.01)
    monkeypatch.setattr(twins.stage, "receive", delay(twins.stage.receive))
    monkeypatch.setattr(twins.force_torque, "_answer", delay(twins.force_torque._answer))
    twins.description["patience"] = patience
    assert list(problems(twins)) == devices


def test_a_gel_that_a_held_part_hides_is_not_taken_for_a_worn_one(twins: TwinStation) -> None:
    """An agent that was killed in a contact leaves its part pressed between the gels; the next one must start."""
    with HandE(twins.description["gripper"]["port"], unit=twins.gripper.unit) as gripper:
        gripper.activate()
        gripper.start_move(255, speed=255, force=100)
        gripper.wait(timeout_s=5.0)
    worn_gel(twins)
    assert problems(twins) == {}


@pytest.mark.parametrize(
    ("firmware", "focal_px", "rules"),
    [
        ("5.15.1", 610.0, []),
        ("5.16.0", 610.0, [DeviceRule.FIRMWARE]),
        ("5.15.1", 640.0, [DeviceRule.CALIBRATION]),
    ],
)
def test_depth_camera_is_compared_with_what_it_has_stored(
    twins: TwinStation, monkeypatch: pytest.MonkeyPatch, firmware: str, focal_px: float, rules: list[DeviceRule]
) -> None:
    """No twin speaks as a RealSense does, so this one stands in for its driver."""

    class Camera(nullcontext[Any]):
        def __init__(self, serial_number: str) -> None:
            super().__init__(self)
            self.identify = lambda: Identity(serial_number=serial_number, firmware=firmware)
            self.intrinsics = lambda: ColourIntrinsics(width=640, height=480, fx=focal_px, fy=610.0, cx=318.0, cy=242.0)
            self.read = lambda: None

    monkeypatch.setattr("vitac.station.devices.cameras.DepthCamera", Camera)
    measured = {"width": 640, "height": 480, "fx": 612, "fy": 611, "cx": 320, "cy": 240}
    twins.description["depth_camera"] = {
        "serial_number": "821312061234",
        "firmware": "5.15.1",
        "calibration": {"serial_number": "821312061234", **measured},
    }
    assert [rule for rule, _ in problems(twins).get("RGB-D camera", [])] == rules


@pytest.mark.parametrize(
    ("change", "rule", "sentences"),
    [
        (
            {"garage": {"x_mm": -90, "y_mm": 0, "z_mm": -30}},
            DeviceRule.LIMITS,
            ["At the garage: Target x_mm -90.0"] * 2,
        ),
        ({"hole": {"x_mm": 0, "y_mm": 4, "z_mm": -40}}, DeviceRule.LIMITS, ["At the hole: Target y_mm 16.0"] * 3),
        (
            {"task": "lock-opening", "shape": "key1"},
            DeviceRule.LIMITS,
            ["At the lock: Target x_mm 77.0: expected -60.0 to 15.0"] * 2,
        ),
        ({"push_mm": 8}, DeviceRule.LIMITS, ["At the hole: Target z_mm -49.0: expected -48.0 to 0.0"] * 2),
        ({"grip_force": 101}, DeviceRule.LIMITS, ["Gripper force 101: expected 0 to 100."]),
        ({"sam_weights": "none.pth"}, DeviceRule.FOUND, ["Expected the weights of SAM at none.pth, got no file."]),
    ],
)
def test_procedure_that_leads_past_the_limits_is_named(
    twins: TwinStation, change: dict[str, Any], rule: DeviceRule, sentences: list[str]
) -> None:
    twins.description["limits"]["workspace"] |= {"x_mm": [-60, 15], "z_mm": [-48, 0]}
    places = {"hole": {"x_mm": 0, "y_mm": 0, "z_mm": -40}, "garage": {"x_mm": -55, "y_mm": 0, "z_mm": -30}}
    twins.description["procedure"] = {"shape": "cuboid", "safe_z_mm": -20, **places, **change}
    found = problems(twins)
    named = found.pop("procedure")
    assert [each[0] for each in named] == [rule] * len(sentences)
    assert all(each[1].startswith(expected) for each, expected in zip(named, sentences, strict=True)), named
    assert not found


def test_station_that_another_program_plays_on_is_left_alone(twins: TwinStation) -> None:
    with LinearStage(twins.description["stage"]["port"]):
        described = validate(StationDescription, twins.description, "station.yaml")
        (found,) = check_station(described)
    assert found.device == "stage"
    assert [problem.rule for problem in found.problems] == [DeviceRule.FREE]
    assert problems(twins) == {}


def test_every_problem_of_a_device_is_named(twins: TwinStation) -> None:
    other_gel(twins)
    twins.description["left"]["stream"] = None
    other_serial_number(twins)
    no_homing(twins)
    found = problems(twins)
    assert [rule for rule, _ in found["left tactile camera"]] == [DeviceRule.CALIBRATION, DeviceRule.FOUND]
    assert [rule for rule, _ in found["stage"]] == [DeviceRule.SERIAL_NUMBER, DeviceRule.LIMITS]
