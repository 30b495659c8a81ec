"""The only way to the stage and the gripper: within the limits, and stopped when a reading passes one.

A thread reads the force/torque sensor all the time. What it stops stays stopped until an operator releases it.
"""

import math
from collections import deque
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, field
from enum import StrEnum
from threading import Condition, Event, Lock, Thread
from time import monotonic
from typing import Final, Self

import numpy as np
from numpy.typing import NDArray
from vitac.errors import VitacError

from .description import StationLimits
from .devices.force_torque import ForceTorqueSensor, Wrench
from .devices.gripper import HandE
from .devices.stage import DeviceFault, GrblState, LinearStage, Pose, StageStatus

CONTROL_PERIOD_S: Final = 0.02
"""The stage is at rest this long after a reading has passed a limit."""


LARGEST_RADIUS_MM: Final = 12.0
LARGEST_THETA_DEG: Final = 15.0
"""An action that leads further from the hole than these two ends a trial of the peg as the policy's error."""
KEY_X_RANGE_MM, KEY_Z_RANGE_MM = (-5.0, 70.0), (-3.0, 12.0)
"""Of a key in a trial of the lock, from where it is deepest."""
LARGEST_BESIDE_MM: Final = 2.0
"""How far from the middle of a key's handle the gripper closes, along the key and in height, as in simulation."""
KEY_PULL_MM: Final = 5.0
"""Way on which a key whose teeth are in their slots must meet resistance: more than their room there."""


class LimitPassed(VitacError):
    """A command or reading passes a limit of the station's file; nothing moves. The message says which."""


def check_target(limits: StationLimits, target: Pose) -> None:
    """Refuse a target outside of the workspace, or one that is no number.

    A straight motion between two poses of the workspace stays in it.
    """
    intervals = limits.workspace.intervals()
    for (name, (low, high)), value in zip(intervals.items(), target, strict=True):
        if not low <= value <= high:
            raise LimitPassed(
                f"Target {name} {value}: expected {low} to {high}, as the workspace in the file. Not moved."
            )


def check_speed(limits: StationLimits, speed_mm_s: float, rotation_deg_s: float) -> None:
    """Refuse speeds above the limits, and those that are not positive numbers."""
    for name, value, limit in (
        ("speed_mm_s", speed_mm_s, limits.speed_mm_s),
        ("rotation_deg_s", rotation_deg_s, limits.rotation_deg_s),
    ):
        if not 0 < value <= limit:
            raise LimitPassed(f"{name} {value}: expected more than 0 and at most {limit}. Not moved.")


def feed_of(start: Pose, target: Pose, speed_mm_s: float, rotation_deg_s: float) -> float:
    """Return the feed at which neither speed is passed on a straight motion, in GRBL's units.

    GRBL counts millimetres and degrees alike: the feed is the length over all four axes per minute.
    """
    shift_mm = math.dist(start[:3], target[:3])
    turn_deg = abs(target.rotation_deg - start.rotation_deg)
    duration_s = max(shift_mm / speed_mm_s, turn_deg / rotation_deg_s)
    return 60 * math.hypot(shift_mm, turn_deg) / duration_s if duration_s else 60 * speed_mm_s


def check_wrench(limits: StationLimits, wrench: Wrench) -> None:
    """Refuse a force or torque above its limit, and readings that are no numbers."""
    force_n, torque_nm = math.hypot(*wrench[:3]), math.hypot(*wrench[3:])
    if not force_n <= limits.force_n:
        raise LimitPassed(f"Force {force_n:.2f} N: expected at most {limits.force_n} N.")
    if not torque_nm <= limits.torque_nm:
        raise LimitPassed(f"Torque {torque_nm:.3f} N m: expected at most {limits.torque_nm} N m.")


def check_markers(limits: StationLimits, movement_px: NDArray[np.float64]) -> None:
    """Refuse a marker that has moved too far, shape [n, 2] [pixel], and movements that are no numbers."""
    largest_px = float(np.hypot(*movement_px.T).max(initial=0.0))
    if not largest_px <= limits.marker_movement_px:
        raise LimitPassed(f"A marker moved by {largest_px:.1f} px: expected at most {limits.marker_movement_px} px.")


def check_grip(limits: StationLimits, position: int, speed: int, force: int) -> None:
    """Refuse a command to the gripper that is harder than the file allows."""
    low, high = limits.gripper.position
    for name, value, lowest, highest in (
        ("position", position, low, high),
        ("speed", speed, 0, limits.gripper.speed),
        ("force", force, 0, limits.gripper.force),
    ):
        if not lowest <= value <= highest:
            raise LimitPassed(f"Gripper {name} {value}: expected {lowest} to {highest}. Not moved.")


_LATE_FACTOR: Final = 3.0
_LATE_S: Final = 10.0
"""A motion that takes as many times as long as its way at its speed, and this much more, does not end by itself."""
_MEAN_OF: Final = 100
"""Frames of the force/torque sensor whose mean is taken for its present reading."""
_ARRIVAL_S: Final = 5.0
_FORCES: Final = 1_000_000


def _mean(wrenches: list[Wrench]) -> Wrench:
    return Wrench(*np.mean(wrenches, axis=0).tolist())


class StopCause(StrEnum):
    """What stopped a station."""

    FORCE = "force"
    """The limit of force or torque."""
    LIMIT = "limit"
    """Another limit, or somebody."""
    FAULT = "fault"
    """A device."""


class StationStopped(VitacError):
    """The station is stopped, and the message says why: make it safe, then release it."""


@dataclass(kw_only=True)
class Guard:
    """Commands the devices of a station; use it in `with`, which watches the force/torque sensor meanwhile.

    Attributes:
        limits: of the station's file.
        stage: at rest and homed.
        gripper: activated.
        force_torque: its stream has started.
        clock: the time that heartbeats are counted by.
        picture_s: the station's time that passes with each heartbeat, which a twin may need longer for; motions are
            bounded by it.
        stopped_by: what stopped it the last time.
        forces_n: sizes of the last forces; whoever wants those of a time clears it at its start.
    """

    limits: StationLimits
    stage: LinearStage
    gripper: HandE
    force_torque: ForceTorqueSensor
    clock: Callable[[], float] = monotonic
    picture_s: float = 0.04
    stopped_by: StopCause | None = None
    forces_n: deque[float] = field(default_factory=lambda: deque(maxlen=_FORCES))
    _reason: str | None = None
    _heard_s: float = 0.0
    _time_s: float = 0.0
    _late_s: float = math.inf
    _over: Event = field(default_factory=Event)
    _zeroes: Event = field(default_factory=Event)
    _stopping: Lock = field(default_factory=Lock)
    _wrenches: deque[Wrench] = field(default_factory=lambda: deque(maxlen=_MEAN_OF))
    _frames: int = 0
    _arrived: Condition = field(default_factory=Condition)
    _exits: ExitStack = field(default_factory=ExitStack)

    def __enter__(self) -> Self:
        self._exits.enter_context(self.stage.held_if_killed())
        self.beat()
        self._thread = Thread(target=self._watch, name="guard of the station", daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._thread.join()
        if self._reason is None:
            self.stop("Nobody guards it.")
        self._exits.close()

    @property
    def reason(self) -> str | None:
        """Why the station is stopped; None while it is not."""
        return self._reason

    def wrench(self) -> Wrench | None:
        """Return the mean of the last forces and torques; None where none has arrived."""
        return _mean(list(self._wrenches)) if self._wrenches else None

    def measure_wrench(self, frames: int = 10) -> Wrench:
        """Return the mean of the next forces and torques: nothing in it was felt before the call.

        Raises:
            DeviceFault: too few arrive within five seconds, or `reading_s` where that is longer.
        """
        with self._arrived:
            enough = self._frames + frames
            if not self._arrived.wait_for(lambda: self._frames >= enough, max(_ARRIVAL_S, self.limits.reading_s)):
                raise DeviceFault("The force/torque sensor has sent nothing. Check its cable.")
            return _mean(list(self._wrenches)[-frames:])

    def zero_forces(self) -> None:
        """Take the present forces and torques for zero, with nothing held: a sensor's zero drifts over hours.

        Raises:
            StationStopped: the sensor failed, or something else stops the station.
        """
        self._zeroes.set()
        while self._zeroes.is_set():
            self._over.wait(CONTROL_PERIOD_S / 4)
            self.check_released()

    def beat(self) -> None:
        """Say that whoever commands the station is alive."""
        self._heard_s = self.clock()
        self._time_s += self.picture_s

    def move(self, target: Pose, *, speed_mm_s: float, rotation_deg_s: float) -> None:
        """Start a straight motion; return while the stage moves.

        Raises:
            LimitPassed: the target or a speed; nothing was sent.
            StationStopped: the station is stopped.
            DeviceFault: the stage is in alarm or still moves.
        """
        check_target(self.limits, target)
        check_speed(self.limits, speed_mm_s, rotation_deg_s)
        self.check_released()
        status = self.stage.status()
        if status.state is not GrblState.IDLE:
            raise DeviceFault(f"Expected a stage at rest, got {status.state}. Wait for it, or home it after an alarm.")
        check_target(self.limits, status.pose)
        feed = feed_of(status.pose, target, speed_mm_s, rotation_deg_s)
        self._bound_motion(60 * math.dist(status.pose, target) / feed)
        try:
            self.stage.start_move(target, feed=feed)
        except DeviceFault as error:
            self.stop(str(error), cause=StopCause.FAULT)
            raise
        if self._reason is not None:  # stopped before the controller had the motion, so the hold did nothing
            self.stage.hold()
            self.check_released()

    def wait(self) -> StageStatus:
        """Return when the motion has ended.

        Raises:
            StationStopped: it was stopped.
            DeviceFault: the stage is in alarm, or does not arrive in time.
        """
        while True:
            self.check_released()
            self.check_motion()
            status = self.stage.status()
            if status.state is GrblState.ALARM:
                self.stop("The stage is in alarm.", cause=StopCause.FAULT)
                raise DeviceFault("The stage is in alarm: clear its way, then home it.")
            if status.state is GrblState.IDLE:
                self.check_released()
                return status
            self._over.wait(CONTROL_PERIOD_S / 4)

    def end_motion(self) -> StageStatus:
        """End the motion where the stage is, as a procedure does that has found what it looked for."""
        self.check_released()
        self.stage.hold()
        self._await_rest()
        with self._stopping:
            if self._reason is None:
                self.stage.forget_motion()
        return self.wait()

    def grip(self, position: int, *, speed: int, force: int) -> None:
        """Start to open or close the gripper, within the limits."""
        check_grip(self.limits, position, speed, force)
        self.check_released()
        self.gripper.start_move(position, speed=speed, force=force)

    def see_markers(self, movement_px: NDArray[np.float64]) -> None:
        """Stop if a marker has moved too far, shape [n, 2] [pixel]."""
        try:
            check_markers(self.limits, movement_px)
        except LimitPassed as error:
            self.stop(str(error))

    def stop(self, reason: str, *, cause: StopCause = StopCause.LIMIT) -> None:
        """Hold the stage at once; the first reason counts. The gripper holds on to what it has.

        Args:
            reason: a sentence.
            cause: what stops it.
        """
        with self._stopping:
            is_first, self._reason = self._reason is None, self._reason or reason
            if is_first:
                self.stopped_by = cause
                try:
                    self.stage.hold()
                except DeviceFault as error:
                    self._reason = f"{reason} The stage could not be held: {error}"

    def release(self) -> None:
        """Discard what is left of the motion and allow commands again, as an operator decides.

        Raises:
            DeviceFault: the stage does not come to rest.
        """
        self._await_rest()
        with self._stopping:  # who stops it meanwhile stops it again afterwards
            self.stage.forget_motion()
            self.beat()
            self._reason = None

    def check_released(self) -> None:
        """Raise StationStopped while the station is stopped."""
        if self._reason is not None:
            raise StationStopped(f"The station is stopped: {self._reason} Make it safe, then release it.")

    def check_motion(self) -> None:
        """Stop a stage that should long be where it was sent, and raise DeviceFault."""
        if self._time_s > self._late_s:
            reason = (
                f"The stage should have been at rest {_LATE_S:g} s ago. Look what holds it, such as a button or a door "
                "of its controller."
            )
            self.stop(reason, cause=StopCause.FAULT)
            raise DeviceFault(reason)

    def _bound_motion(self, expected_s: float) -> None:
        self._late_s = self._time_s + _LATE_FACTOR * expected_s + _LATE_S

    def _await_rest(self) -> None:
        self._bound_motion(0.0)
        while self.stage.status().is_moving:
            self.check_motion()
            self._over.wait(CONTROL_PERIOD_S / 4)

    def _zero(self) -> None:
        try:
            self.force_torque.zero_again()
            self._wrenches.clear()
        finally:
            self._zeroes.clear()

    def _watch(self) -> None:
        while not self._over.is_set():
            try:
                if self._zeroes.is_set():
                    self._zero()
                for wrench in self.force_torque.read(timeout_s=self.limits.reading_s):
                    check_wrench(self.limits, wrench)
                    with self._arrived:
                        self._wrenches.append(wrench)
                        self._frames += 1
                        self._arrived.notify_all()
                    self.forces_n.append(math.hypot(*wrench[:3]))
            except LimitPassed as error:
                self.stop(str(error), cause=StopCause.FORCE)
            except DeviceFault as error:
                self.stop(str(error), cause=StopCause.FAULT)
                self._over.wait(CONTROL_PERIOD_S)
            silent_s = self.clock() - self._heard_s
            if silent_s > self.limits.heartbeat_s:
                self.stop(f"No heartbeat for {silent_s:.2f} s: expected one every {self.limits.heartbeat_s} s.")
