"""Checks that the devices of a station are those of its file, and fit its limits. Moves nothing."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum
from itertools import product
from typing import Final

from vitac.errors import VitacError

from .description import (
    Calibration,
    DepthCameraSettings,
    OverviewSettings,
    Procedure,
    StationDescription,
    StationLimits,
    StationTask,
)
from .description import TactileCameraSettings as TactileCameraDescription
from .devices import cameras, force_torque, gripper, stage
from .devices.stage import DeviceInUse, DeviceNotFound, Identity, Pose
from .guard import (
    CONTROL_PERIOD_S,
    KEY_PULL_MM,
    KEY_X_RANGE_MM,
    KEY_Z_RANGE_MM,
    LARGEST_BESIDE_MM,
    LARGEST_RADIUS_MM,
    LARGEST_THETA_DEG,
    LimitPassed,
    check_grip,
    check_target,
)
from .perception.markers import DROPPED_PICTURES, cut_picture, find_markers

_BRAKING_S: Final = CONTROL_PERIOD_S / 2
"""What of it the stage has to slow down; the rest is for the reading and the command."""
_READING_S: Final = 1.0
_SAME: Final = 0.02
"""Relative difference up to which two calibrations are of the same sensor."""
_FOUND_MARKERS: Final = 0.95
"""Part of the calibrated markers that must be found in a picture of a free gel."""
_AXES: Final = ("x", "y", "z", "the rotary axis")


class DeviceRule(StrEnum):
    """What a device must do."""

    FOUND = "found"
    """It answers at its address."""
    FREE = "free"
    """No other program uses it."""
    WORKS = "works"
    """It answers without a fault."""
    SERIAL_NUMBER = "serial number"
    FIRMWARE = "firmware"
    CALIBRATION = "calibration"
    """It is the one that was calibrated."""
    LIMITS = "limits"
    """It can keep the limits."""


@dataclass(frozen=True, kw_only=True)
class Problem:
    """What is wrong with a device, in a sentence."""

    rule: DeviceRule
    sentence: str


@dataclass(frozen=True, kw_only=True)
class DeviceCheck:
    """What was found about one device; it is as it should be if there are no problems."""

    device: str
    problems: tuple[Problem, ...]


def check_station(description: StationDescription) -> Iterator[DeviceCheck]:
    """Check all devices; only the stage if another program uses it, because it may be moving."""
    devices: dict[str, Iterator[Problem]] = {
        "stage": _check_stage(description),
        "left tactile camera": _check_tactile_camera(description, description.left),
        "right tactile camera": _check_tactile_camera(description, description.right),
        "force/torque sensor": _check_force_torque(description),
        "gripper": _check_gripper(description),
    }
    if description.procedure is not None:
        devices["procedure"] = check_procedure(description.procedure, description.limits)
    if description.depth_camera is not None:
        devices["RGB-D camera"] = _check_depth_camera(description.depth_camera, description.patience)
    if description.overview is not None:
        devices["overview camera"] = _check_overview(description.overview, description.patience)
    for device, problems in devices.items():
        checked = DeviceCheck(device=device, problems=tuple(_until_failure(problems)))
        yield checked
        if any(problem.rule is DeviceRule.FREE for problem in checked.problems):
            return


def _until_failure(problems: Iterator[Problem]) -> Iterator[Problem]:
    try:
        yield from problems
    except DeviceInUse as error:
        yield Problem(rule=DeviceRule.FREE, sentence=str(error))
    except DeviceNotFound as error:
        yield Problem(rule=DeviceRule.FOUND, sentence=str(error))
    except VitacError as error:
        yield Problem(rule=DeviceRule.WORKS, sentence=str(error))


def _check_overview(camera: OverviewSettings, patience: float) -> Iterator[Problem]:
    with cameras.UsbCamera("overview camera", camera.serial_number, camera.stream, patience=patience) as opened:
        opened.read()
    yield from ()


def _check_tactile_camera(description: StationDescription, camera: TactileCameraDescription) -> Iterator[Problem]:
    """Check a camera; count its markers unless a part is pressed onto the gel, as after an agent that was killed."""
    yield from _check_calibration(camera.serial_number, camera.calibration)
    patience = description.patience
    with cameras.GelSightCamera(camera.serial_number, stream=camera.stream, patience=patience) as opened:
        for _ in range(DROPPED_PICTURES):
            opened.read()
        seen, expected = len(find_markers(cut_picture(opened.read()))), camera.calibration.markers
    if seen < _FOUND_MARKERS * expected and not _holds_part(description):
        yield _calibration(
            f"Expected {expected} markers on the gel, got {seen}. Clean it, or replace and calibrate it."
        )


def _check_depth_camera(camera: DepthCameraSettings, patience: float) -> Iterator[Problem]:
    yield from _check_calibration(camera.serial_number, camera.calibration)
    with cameras.open_depth_camera(camera, patience=patience) as opened:
        yield from _check_identity(opened.identify(), camera.serial_number, camera.firmware)
        measured, stored = camera.calibration, opened.intrinsics()
        for name in ("width", "height", "fx", "fy", "cx", "cy"):
            yield from _check_value(name, getattr(measured, name), getattr(stored, name))
        opened.read()


def _check_force_torque(description: StationDescription) -> Iterator[Problem]:
    sensor, patience = description.force_torque, description.patience
    yield from _check_calibration(sensor.serial_number, sensor.calibration)
    with force_torque.ForceTorqueSensor(sensor.host, sensor.port, patience=patience) as opened:
        stored = opened.decoupling()
        if [len(row) for row in stored] != [6] * 6:
            yield _calibration(f"Expected a matrix of 6 x 6 from the box, got rows of {[len(row) for row in stored]}.")
        elif not _is_same_matrix(stored, sensor.calibration.decoupling):
            yield _calibration(
                "The box has the decoupling matrix of another sensor than the file. Send it this sensor's by AT+DCPM."
            )
        opened.start(sensor.rate_hz)
        opened.read(timeout_s=_READING_S * patience)
        opened.stop()


def _check_stage(description: StationDescription) -> Iterator[Problem]:
    described, limits = description.stage, description.limits
    yield from _check_calibration(described.serial_number, described.calibration)
    with stage.LinearStage(described.port, patience=description.patience) as opened:
        if opened.status().state is stage.GrblState.HOLD:
            opened.forget_motion()  # of an agent that was killed: in a hold the controller reads no questions
        yield from _check_identity(opened.identify(), described.serial_number, described.firmware)
        settings = opened.settings()
        for axis, name in enumerate(_AXES):
            steps = settings.get(100 + axis, 0.0)
            yield from _check_value(f"steps of {name}", described.calibration.steps[axis], steps)
        yield from _check_braking(settings, limits)
        for number, meaning in {20: "soft limits", 22: "homing"}.items():
            if not settings.get(number):
                yield Problem(rule=DeviceRule.LIMITS, sentence=f"The stage has no {meaning}: set ${number}=1.")
        if opened.status().state is stage.GrblState.ALARM:
            yield Problem(
                rule=DeviceRule.WORKS, sentence="The stage is locked by an alarm: clear its way, then home it."
            )


def _check_braking(settings: dict[int, float], limits: StationLimits) -> Iterator[Problem]:
    speeds = [limits.speed_mm_s] * 3 + [limits.rotation_deg_s]
    for axis, (name, speed) in enumerate(zip(_AXES, speeds, strict=True)):
        needed = speed / _BRAKING_S
        if settings.get(120 + axis, 0.0) < needed:
            yield Problem(
                rule=DeviceRule.LIMITS,
                sentence=f"From {speed} a second {name} must stop in {1e3 * _BRAKING_S:.0f} ms: expected ${120 + axis} "
                f"of at least {needed:.0f}, got {settings.get(120 + axis, 0.0):.0f}. Raise it, or lower the speed.",
            )


def _open_gripper(description: StationDescription) -> gripper.HandE:
    described = description.gripper
    return gripper.HandE(described.port, unit=described.unit, patience=description.patience)


def _holds_part(description: StationDescription) -> bool:
    with _open_gripper(description) as opened:
        return opened.status().holds_object


def _check_gripper(description: StationDescription) -> Iterator[Problem]:
    with _open_gripper(description) as opened:
        opened.check_fault(opened.status())
    yield from ()  # a generator, as the other checks; a fault is raised


def check_procedure(procedure: Procedure, limits: StationLimits) -> Iterator[Problem]:
    """Check that no trial can end at a limit of the station, whatever its policy does."""
    for place, pose in _extreme_poses(procedure):
        try:
            check_target(limits, pose)
        except LimitPassed as error:
            yield Problem(rule=DeviceRule.LIMITS, sentence=f"At the {place}: {error}")
    try:
        check_grip(limits, procedure.open_position, limits.gripper.speed, procedure.grip_force)
    except LimitPassed as error:
        yield Problem(rule=DeviceRule.LIMITS, sentence=str(error))
    weights = procedure.sam_weights
    if weights is not None and not weights.is_file():
        yield Problem(rule=DeviceRule.FOUND, sentence=f"Expected the weights of SAM at {weights}, got no file.")


def _extreme_poses(procedure: Procedure) -> Iterator[tuple[str, Pose]]:
    """Yield the outermost poses of a trial of the peg or the lock, each with the name of its place."""
    hole, garage, safe_mm = procedure.hole, procedure.garage, procedure.safe_z_mm
    if procedure.task is StationTask.LOCK:
        (nearest, farthest), beside, angle = KEY_X_RANGE_MM, LARGEST_BESIDE_MM, math.radians(hole.rotation_deg)
        for out_mm, up_mm in product((nearest - beside, farthest + KEY_PULL_MM + beside), KEY_Z_RANGE_MM):
            x_mm, y_mm = hole.x_mm + math.cos(angle) * out_mm, hole.y_mm + math.sin(angle) * out_mm
            yield "lock", Pose(x_mm, y_mm, hole.z_mm + up_mm + math.copysign(beside, up_mm), hole.rotation_deg)
        for sign, z_mm in product((-1.0, 1.0), (garage.z_mm, safe_mm)):
            yield "garage", Pose(garage.x_mm + sign * beside, garage.y_mm, z_mm + sign * beside, garage.rotation_deg)
        return
    lowest_mm = hole.z_mm + procedure.start_mm - procedure.descent_mm - procedure.push_mm
    for z_mm, sign in product((lowest_mm, hole.z_mm + procedure.lateral_mm, safe_mm), (-1.0, 1.0)):
        far_mm, turn_deg = sign * LARGEST_RADIUS_MM, sign * LARGEST_THETA_DEG
        yield "hole", Pose(hole.x_mm + far_mm, hole.y_mm + far_mm, z_mm, hole.rotation_deg + turn_deg)
    for z_mm in (garage.z_mm, safe_mm):
        yield "garage", Pose(garage.x_mm, garage.y_mm, z_mm, garage.rotation_deg)


def _check_calibration(serial_number: str, calibration: Calibration) -> Iterator[Problem]:
    if calibration.serial_number != serial_number:
        yield _calibration(
            f"The calibration is of {calibration.serial_number}, expected one of {serial_number}. Calibrate this one."
        )


def _check_identity(identity: Identity, serial_number: str, firmware: str) -> Iterator[Problem]:
    if identity.serial_number != serial_number:
        sentence = f"Expected serial number {serial_number}, got {identity.serial_number}. Plug in the right device."
        yield Problem(rule=DeviceRule.SERIAL_NUMBER, sentence=sentence)
    if identity.firmware != firmware:
        sentence = (
            f"Expected firmware {firmware}, got {identity.firmware}. Try it with the new one, then correct the file."
        )
        yield Problem(rule=DeviceRule.FIRMWARE, sentence=sentence)


def _check_value(name: str, described: float, stored: float) -> Iterator[Problem]:
    if abs(described - stored) > _SAME * abs(described):
        yield _calibration(f"{name}: expected {described} as in the file, the device has {stored}. Calibrate it.")


def _is_same_matrix(stored: list[list[float]], described: tuple[tuple[float, ...], ...]) -> bool:
    largest = max(abs(value) for row in described for value in row)
    pairs = zip(stored, described, strict=True)
    return all(abs(a - b) <= 1e-4 * largest for rows in pairs for a, b in zip(*rows, strict=True))


def _calibration(sentence: str) -> Problem:
    return Problem(rule=DeviceRule.CALIBRATION, sentence=sentence)
