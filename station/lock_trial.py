"""Plays one trial of the lock on a station: a procedure of ours, since the challenge published none."""

import math
from typing import ClassVar, Final

import numpy as np
from vitac.evaluator.episodes.episode import PlayingPolicy

from .arm import Offset
from .devices.stage import Pose
from .eyes import SensorReading
from .guard import KEY_PULL_MM, KEY_X_RANGE_MM, KEY_Z_RANGE_MM, LARGEST_BESIDE_MM
from .held_part import Beside
from .outcome import TrialOutcome
from .preflight import PreflightFinding
from .trial import StationTrial

_LIFTED_MM: Final = 4.0
"""The teeth are 3 mm above the channel's ceiling then, where simulation says that the lock is open."""


class LockTrial(StationTrial):
    """Attempts at one episode of the lock task.

    The key is taken from its garage in front of the lock, gripped again each time, and slid in to the start. Places are
    those of the key from where `hole` is, as a list has them; the gripper holds it beside the middle of its handle, and
    the policy knows neither.
    """

    part: ClassVar = "key"
    _motion_axes: ClassVar[tuple[int, ...]] = (0, 1, 2)

    def _find_start(self, offset: tuple[float, ...]) -> Offset:
        x_mm, y_mm, self._start_mm = offset
        drawn = np.random.default_rng((self._episode.list_seed, self._episode.number))
        self._beside_mm: Beside = tuple(drawn.uniform(-LARGEST_BESIDE_MM, LARGEST_BESIDE_MM, 2).tolist())
        return x_mm, y_mm, 0.0

    def _grasp(self) -> list[PreflightFinding]:
        """Hold the key in front of its lock, at the height of the start, and return what was measured of it there."""
        self._take_away()
        self._arm.fetch(beside_mm=self._beside_mm)
        self._station.thresholds_px = self._measure_noise()
        self._arm.go(self._in_front())
        return self._take_references(self._station.thresholds_px)

    def _approach(self) -> float:
        self._arm.go(self._gripper_pose(self._start[0], self._start_mm), self._station.procedure.step_mm_s)
        return self._start_mm

    def _insert(self, policy: PlayingPolicy, start_mm: float) -> TrialOutcome:
        attempt, arm, x_mm, z_mm = self._attempt, self._arm, self._start[0], start_mm
        sight = self._look()
        while len(attempt.actions) < self._task.max_steps:
            self._wait_before_step()
            action = policy.act(self._observe(sight))
            inwards_mm, down_mm = self._scaled(action)
            x_mm, z_mm = x_mm - inwards_mm, z_mm - down_mm
            attempt.actions.append(np.array(action, dtype=np.float32))
            (nearest, farthest), (lowest, highest) = KEY_X_RANGE_MM, KEY_Z_RANGE_MM
            if not (nearest <= x_mm <= farthest and lowest <= z_mm <= highest):
                return TrialOutcome.ERROR
            arm.go(self._gripper_pose(x_mm, z_mm), self._station.procedure.step_mm_s)
            sight = self._look()
            self._show(f"step-{len(attempt.actions)}", sight)
            if sight.is_over_force():
                return TrialOutcome.TACTILE
            if z_mm > _LIFTED_MM and self._is_relaxed() and self._resists_a_pull(sight, x_mm, z_mm):
                return TrialOutcome.SUCCESS
        return TrialOutcome.STEPS

    def _resists_a_pull(self, before: SensorReading, x_mm: float, z_mm: float) -> bool:
        """Pull the key outwards, and go back: one whose teeth are in their slots stays where it is."""
        is_held = self._feels_resistance(before, self._gripper_pose(x_mm + KEY_PULL_MM, z_mm))
        self._arm.go(self._gripper_pose(x_mm, z_mm))
        return is_held

    def _take_away(self) -> None:
        """Take a key that is held down out of the slots, and out of its lock."""
        if self._arm.holds_peg() and self._arm.pose().z_mm < self._station.procedure.safe_z_mm:
            self._arm.go(self._arm.pose()._replace(z_mm=self._gripper_pose(0.0, self._start_mm).z_mm))
            self._arm.go(self._in_front())

    def _in_front(self) -> Pose:
        """Return where the gripper holds the key before its lock."""
        hole, garage = self._station.procedure.hole, self._station.procedure.garage
        angle = math.radians(hole.rotation_deg)
        along = math.cos(angle) * (garage.x_mm - hole.x_mm) + math.sin(angle) * (garage.y_mm - hole.y_mm)
        return self._gripper_pose(along, self._start_mm)

    def _gripper_pose(self, x_mm: float, z_mm: float) -> Pose:
        """Return where the gripper holds a key that is so far out of its deepest place, and above it."""
        beside_x_mm, beside_z_mm = self._station.held.beside_mm
        return self._arm.place((x_mm + beside_x_mm, self._start[1], 0.0), self._arm.height_mm(z_mm + beside_z_mm))
