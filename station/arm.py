"""The motions of trials: over plate and garage, with and without a peg. All of them go through the guard."""

import math
from collections.abc import Callable
from typing import Final

from vitac.errors import VitacError

from .devices.gripper import Grasp, GripperStatus
from .devices.stage import DeviceFault, Pose
from .eyes import OpenStation, SensorReading
from .held_part import Beside

Offset = tuple[float, float, float]

_SETTLE_S: Final = 0.1
_GRIP_S: Final = 5.0


class NoPeg(VitacError):
    """The gripper holds no peg; put it into its garage."""


class Arm:
    """Stage and gripper of an open station."""

    def __init__(self, station: OpenStation) -> None:
        self._station = station
        self._guard, self._procedure, self._limits = station.guard, station.procedure, station.description.limits

    def pose(self) -> Pose:
        """Return where the encoders say the stage is."""
        return self._station.stage.status().pose

    def height_mm(self, above_mm: float) -> float:
        """Return the stage's z at which the peg is this far above the plate."""
        return self._procedure.hole.z_mm + above_mm

    def place(self, offset: Offset, z_mm: float) -> Pose:
        """Return the stage's pose at an offset of the peg from its hole: x [mm], y [mm], angle [deg]."""
        hole, (x, y, theta_deg) = self._procedure.hole, offset
        angle = math.radians(hole.rotation_deg)
        along = math.cos(angle) * x - math.sin(angle) * y, math.sin(angle) * x + math.cos(angle) * y
        return Pose(hole.x_mm + along[0], hole.y_mm + along[1], z_mm, hole.rotation_deg + theta_deg)

    def start(self, target: Pose, speed_mm_s: float | None = None) -> None:
        """Start a motion, at the limit of speed unless another speed is given."""
        speed = min(speed_mm_s or math.inf, self._limits.speed_mm_s)
        self._guard.move(target, speed_mm_s=speed, rotation_deg_s=self._limits.rotation_deg_s)

    def go(self, target: Pose, speed_mm_s: float | None = None) -> None:
        """Move there; return at rest."""
        self.start(target, speed_mm_s)
        self._guard.wait()

    def go_until(
        self, target: Pose, speed_mm_s: float, is_reached: Callable[[SensorReading, Pose], bool]
    ) -> SensorReading | None:
        """Move there until something is found, and return what was seen then; None if it was not found."""
        self.start(target, speed_mm_s)
        while True:
            sight, status = self._station.eyes.see(), self._station.stage.status()
            self._guard.check_released()
            self._guard.check_motion()
            if is_reached(sight, status.pose):
                self._guard.end_motion()
                return sight
            if not status.is_moving:
                self._guard.wait()
                return None

    def lift(self, z_mm: float) -> None:
        """Go straight up to a height; stay where the stage is higher."""
        pose = self.pose()
        if pose.z_mm < z_mm:
            self.go(pose._replace(z_mm=z_mm))

    def settle(self, wait_s: float = _SETTLE_S) -> SensorReading:
        """Wait, and return what is seen then.

        Raises:
            NoPeg: the gripper has lost its peg.
        """
        sight = self._wait(wait_s)
        self.check_peg()
        return sight

    def holds_peg(self) -> bool:
        """Say whether the fingers have closed on something."""
        return self._is_holding(self._station.gripper.status())

    def _is_holding(self, status: GripperStatus) -> bool:
        self._station.gripper.check_fault(status)
        return status.holds_object and status.position > self._procedure.open_position

    def check_peg(self) -> None:
        """Raise NoPeg where the peg is gone, DeviceFault where the fingers move by themselves."""
        status = self._station.gripper.status()
        if self._is_holding(status):
            return
        if status.grasp is Grasp.MOVING:
            raise DeviceFault("The gripper reports that its fingers move, though it was not asked to. Free them.")
        raise NoPeg("The gripper has lost its peg or key. Put it back into the garage.")

    def fetch(self, grip_force: int | None = None, beside_mm: Beside = (0.0, 0.0)) -> None:
        """Take the peg from its garage; a peg that the gripper holds is put there first.

        Args:
            grip_force: other than the procedure's; the gels then may feel less than a contact.
            beside_mm: where the gripper closes on it, along the stage's x and z from the place in the file.
        """
        self.open_in_garage(beside_mm)
        self._station.eyes.start_again()
        self._station.held.remember(beside_mm)
        self._grip(self._limits.gripper.position[1], grip_force)
        sight = self._wait(_SETTLE_S)
        is_felt = grip_force is not None or (sight.left.is_contact() and sight.right.is_contact())
        if not (self.holds_peg() and is_felt):
            self._grip(self._procedure.open_position)
            raise NoPeg("The gripper closed on nothing in the garage. Put peg or key into it.")
        self.lift(self._procedure.safe_z_mm)

    def open_in_garage(self, beside_mm: Beside = (0.0, 0.0)) -> None:
        """Open the gripper in the garage, where a peg that it holds stays as it was, and go beside its place there.

        Nothing is held then, so that the force/torque sensor is zeroed.
        """
        safe_mm = self._procedure.safe_z_mm
        self.lift(safe_mm)
        is_held = self.holds_peg()
        if not is_held:
            self._grip(self._procedure.open_position)
        there = self._garage(self._station.held.beside_mm if is_held else beside_mm)
        self.go(there._replace(z_mm=safe_mm))
        self.go(there)
        if is_held:
            self._grip(self._procedure.open_position)
            self.go(self._garage(beside_mm))
        self._wait(_SETTLE_S)
        self._guard.zero_forces()

    def _garage(self, beside_mm: Beside) -> Pose:
        garage, (x_mm, z_mm) = self._procedure.garage, beside_mm
        return Pose(garage.x_mm + x_mm, garage.y_mm, garage.z_mm + z_mm, garage.rotation_deg)

    def _wait(self, wait_s: float) -> SensorReading:
        """Wait, longer by the latency of the pictures."""
        wait_s += self._procedure.latency_s
        return self._station.eyes.wait(math.ceil(wait_s / self._procedure.picture_s))

    def _grip(self, position: int, force: int | None = None) -> None:
        force = self._procedure.grip_force if force is None else force
        self._guard.grip(position, speed=self._limits.gripper.speed, force=force)
        self._station.gripper.wait(timeout_s=_GRIP_S)
