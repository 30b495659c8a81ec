"""The only way to the stage and the gripper: within the limits, and stopped when a reading passes one.

A thread reads the force/torque sensor all the time. What it stops stays stopped until an operator releases it.
"""

from collections import deque
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, field
from threading import Event, Lock, Thread
from time import monotonic
from typing import Final, Self

import numpy as np
from numpy.typing import NDArray
from vitac.envs.errors import VitacError

from .description import Limits
from .devices.device import DeviceFault
from .devices.force_torque import ForceTorqueSensor, Wrench
from .devices.gripper import Gripper
from .devices.stage import Pose, Stage, StageState, StageStatus
from .limits import (
    CONTROL_PERIOD_S,
    LimitPassed,
    check_grip,
    check_markers,
    check_speed,
    check_target,
    check_wrench,
    feed_of,
)

_MEAN_OF: Final = 100
"""Frames of the force/torque sensor whose mean is taken for its present reading."""


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
        by_fault: whether a device's fault stopped it, rather than a limit.
    """

    limits: Limits
    stage: Stage
    gripper: Gripper
    force_torque: ForceTorqueSensor
    clock: Callable[[], float] = monotonic
    by_fault: bool = False
    _reason: str | None = None
    _heard_s: float = 0.0
    _over: Event = field(default_factory=Event)
    _stopping: Lock = field(default_factory=Lock)
    _wrenches: deque[Wrench] = field(default_factory=lambda: deque(maxlen=_MEAN_OF))
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
        return Wrench(*np.mean(list(self._wrenches), axis=0).tolist()) if self._wrenches else None

    def beat(self) -> None:
        """Say that whoever commands the station is alive."""
        self._heard_s = self.clock()

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
        if status.state is not StageState.IDLE:
            raise DeviceFault(f"Expected a stage at rest, got {status.state}. Wait for it, or home it after an alarm.")
        check_target(self.limits, status.pose)
        self.stage.start_move(target, feed=feed_of(status.pose, target, speed_mm_s, rotation_deg_s))
        if self._reason is not None:  # stopped before the controller had the motion, so the hold did nothing
            self.stage.hold()
            self.check_released()

    def wait(self) -> StageStatus:
        """Return when the motion has ended; raise StationStopped if it was stopped, DeviceFault in alarm."""
        while True:
            self.check_released()
            status = self.stage.status()
            if status.state is StageState.ALARM:
                self.stop("The stage is in alarm.", by_fault=True)
                raise DeviceFault("The stage is in alarm: clear its way, then home it.")
            if status.state is StageState.IDLE:
                self.check_released()
                return status
            self._over.wait(CONTROL_PERIOD_S / 4)

    def end_motion(self) -> StageStatus:
        """End the motion where the stage is, as a procedure does that has found what it looked for."""
        self.check_released()
        self.stage.hold()
        while self.stage.status().is_moving:
            self._over.wait(CONTROL_PERIOD_S / 4)
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

    def stop(self, reason: str, *, by_fault: bool = False) -> None:
        """Hold the stage at once; the first reason counts. The gripper holds on to what it has.

        Args:
            reason: a sentence.
            by_fault: whether a device failed, rather than a limit was passed.
        """
        with self._stopping:
            is_first, self._reason = self._reason is None, self._reason or reason
            if is_first:
                self.by_fault = by_fault
                try:
                    self.stage.hold()
                except DeviceFault as error:
                    self._reason = f"{reason} The stage could not be held: {error}"

    def release(self) -> None:
        """Discard what is left of the motion and allow commands again, as an operator decides."""
        while self.stage.status().is_moving:
            self._over.wait(CONTROL_PERIOD_S / 4)
        with self._stopping:  # who stops it meanwhile stops it again afterwards
            self.stage.forget_motion()
            self.beat()
            self._reason = None

    def check_released(self) -> None:
        """Raise StationStopped while the station is stopped."""
        if self._reason is not None:
            raise StationStopped(f"The station is stopped: {self._reason} Make it safe, then release it.")

    def _watch(self) -> None:
        while not self._over.is_set():
            try:
                for wrench in self.force_torque.read(timeout_s=self.limits.reading_s):
                    check_wrench(self.limits, wrench)
                    self._wrenches.append(wrench)
            except LimitPassed as error:
                self.stop(str(error))
            except DeviceFault as error:
                self.stop(str(error), by_fault=True)
                self._over.wait(CONTROL_PERIOD_S)
            silent_s = self.clock() - self._heard_s
            if silent_s > self.limits.heartbeat_s:
                self.stop(f"No heartbeat for {silent_s:.2f} s: expected one every {self.limits.heartbeat_s} s.")
