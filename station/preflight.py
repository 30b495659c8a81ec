"""Conditions that are checked before a trial moves anything, each with its limit and remedy."""

import math
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from vitac.errors import VitacError

from .devices.stage import GrblState
from .eyes import OpenStation

_FOLLOWED_MARKERS = 0.9
"""Part of the calibrated markers that must be followed; less than `check` asks to find, for a moving gel loses some."""
_GB = 1e9


class PreflightRefused(VitacError):
    """The station is not ready for a trial; the message says what is missing, and nothing has moved."""


@dataclass(frozen=True, kw_only=True)
class PreflightFinding:
    """One thing that was measured before a trial.

    Attributes:
        name: of the quantity.
        value: that was found.
        limit: what was expected, in words.
        is_good: whether the value is within the limit.
        remedy: what to do if not.
    """

    name: str
    value: str
    limit: str
    is_good: bool
    remedy: str

    def __str__(self) -> str:
        """Return a sentence."""
        return f"{self.name}: expected {self.limit}, got {self.value}. {self.remedy}"


def check_ready(station: OpenStation, folder: Path) -> list[PreflightFinding]:
    """Return what was measured before a trial whose records go to a folder.

    Raises:
        PreflightRefused: something is not as it must be.
    """
    return _refuse_bad(list(_measure(station, folder)))


def check_held(station: OpenStation) -> list[PreflightFinding]:
    """Return what was measured of gels and force/torque sensor while the peg hangs in free air.

    Raises:
        PreflightRefused: a gel has lost markers since the trial began, or the sensor's zero is off.
    """
    return _refuse_bad([*_measure_gels(station), *_measure_zero(station)])


def has_zero(station: OpenStation) -> bool:
    """Return whether the force/torque sensor shows what it may of a peg that hangs in free air."""
    return all(each.is_good for each in _measure_zero(station))


def _refuse_bad(findings: list[PreflightFinding]) -> list[PreflightFinding]:
    bad = [str(each) for each in findings if not each.is_good]
    if bad:
        raise PreflightRefused(" ".join(bad))
    return findings


def _measure(station: OpenStation, folder: Path) -> Iterator[PreflightFinding]:
    gripper, stage = station.gripper.status(), station.stage.status()
    yield PreflightFinding(
        name="Gripper",
        value="active" if gripper.is_activated else "not active",
        limit="active",
        is_good=gripper.is_activated and not gripper.fault,
        remedy="Activate it.",
    )
    yield PreflightFinding(
        name="Stage",
        value=str(stage.state),
        limit="Idle",
        is_good=stage.state is GrblState.IDLE,
        remedy="Clear its way and home it.",
    )
    if not gripper.holds_object:  # else `check_held` does it in free air, where the part is pressed onto nothing
        yield from _measure_gels(station)
    free_gb, needed_gb = shutil.disk_usage(folder).free / _GB, station.procedure.free_gb
    yield PreflightFinding(
        name="Free disk",
        value=f"{free_gb:.1f} GB",
        limit=f"at least {needed_gb} GB",
        is_good=free_gb >= needed_gb,
        remedy="Remove old records.",
    )


def _measure_gels(station: OpenStation) -> Iterator[PreflightFinding]:
    sight, description = station.eyes.see(), station.description
    sides = {"Left": (sight.left, description.left), "Right": (sight.right, description.right)}
    for side, (flow, camera) in sides.items():
        seen, markers = len(flow.current), camera.calibration.markers
        yield PreflightFinding(
            name=f"{side} gel",
            value=f"{seen} markers",
            limit=f"at least {_FOLLOWED_MARKERS:.0%} of {markers} markers",
            is_good=seen >= _FOLLOWED_MARKERS * markers,
            remedy="Clean it, or replace and calibrate it.",
        )


def _measure_zero(station: OpenStation) -> Iterator[PreflightFinding]:
    wrench, procedure = station.guard.wrench(), station.procedure
    force_n, torque_nm = (math.hypot(*wrench[:3]), math.hypot(*wrench[3:])) if wrench else (math.inf, math.inf)
    yield PreflightFinding(
        name="Zero of the force/torque sensor",
        value=f"{force_n:.2f} N and {torque_nm:.3f} N m",
        limit=f"at most {procedure.zero_n} N and {procedure.zero_nm} N m with nothing touched",
        is_good=force_n <= procedure.zero_n and torque_nm <= procedure.zero_nm,
        remedy="Take out what is held and open the gripper: the sensor is zeroed when the station is opened again.",
    )
