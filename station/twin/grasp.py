"""The twin's peg, gels and plate: the simulation of the envs, driven by where the stage and the gripper really are."""

import logging
from dataclasses import dataclass
from math import ceil, radians
from typing import Final

import numpy as np
from vitac.envs.assets import Meshes
from vitac.envs.fem.model.bodies import GEL_MATERIAL, PART_MATERIAL
from vitac.envs.fem.model.settings import ArenaContactSettings, PairFriction
from vitac.envs.geometry.pegs import PegShape
from vitac.envs.scene.grasped_scene import Clocks, PhysicsSettings
from vitac.envs.scene.gripper import GripperPose
from vitac.envs.scene.stopwatch import Stopwatch
from vitac.envs.tasks.insertion.offset import PegOffset
from vitac.envs.tasks.insertion.scene import InsertionScene
from vitac.envs.tasks.peg_insertion.scene import START_GAP_MM, PegScene
from vitac.envs.tasks.peg_insertion.settings import PegInsertionSettings
from vitac.envs.tasks.peg_insertion.variation import PegStart

from .hidden import HiddenSettings

_logger = logging.getLogger(__name__)

Axes = tuple[float, float, float, float]
Wrench = tuple[float, float, float, float, float, float]

_TIME_STEP_S: Final = 0.04
_WAY_MM: Final = 0.5
"""Longest way in one IPC step."""
_TURN_DEG: Final = 1.0
_PEG, _PLATE = 2, 3
"""Their numbers among the bodies of the scene: the gels are the first two."""
_SENSOR_ABOVE_M: Final = 0.15
"""Middle of the force/torque sensor above the grasp: the length of a Hand-E and its flange."""


@dataclass(frozen=True, kw_only=True)
class _Grasp:
    """Where the gripper was when it met the peg.

    Attributes:
        axes: of the stage, as they really were.
        pose: of the gripper in the scene.
    """

    axes: Axes
    pose: GripperPose


class HeldPeg:
    """A peg between two gels, from its grasp until it is released.

    Attributes:
        scene: gels, peg and plate.
    """

    def __init__(self, shape: PegShape, axes: Axes, hidden: HiddenSettings, meshes: Meshes) -> None:
        """Close on a peg that stands upright where the gripper is."""
        x_mm, y_mm, z_mm, rotation_deg = axes
        settings = _settings(hidden)
        # The peg stands where the gripper is, but for the grasp; PegScene places it above the plate's face.
        self._height_mm = z_mm - hidden.grasp_z_mm - START_GAP_MM
        offset = PegOffset(x_mm=x_mm - hidden.grasp_x_mm, y_mm=y_mm, theta_deg=rotation_deg)
        clocks = Clocks(physics=Stopwatch(), markers=Stopwatch())
        self._peg = _RaisedPeg(
            self._height_mm, start=PegStart(shape=shape, offset=offset), meshes=meshes, settings=settings, clocks=clocks
        )
        InsertionScene.grasp(self._peg)
        self.scene = self._peg.grasped
        self._start = _Grasp(axes=axes, pose=self.scene.pose)
        self._axes = axes

    def follow(self, axes: Axes) -> bool:
        """Move the gripper with the stage, in IPC steps that are short enough; return whether anything moved.

        Where the physics finds no solution nothing moves, and the next call tries again.
        """
        if axes == self._axes:
            return False
        way_mm = max(abs(a - b) for a, b in zip(axes[:3], self._axes[:3], strict=True))
        steps = max(1, ceil(way_mm / _WAY_MM), ceil(abs(axes[3] - self._axes[3]) / _TURN_DEG))
        x_mm, y_mm, z_mm, rotation_deg = (now - before for now, before in zip(axes, self._start.axes, strict=True))
        goal = self._start.pose.moved(
            x_m=1e-3 * x_mm, y_m=1e-3 * y_mm, z_m=1e-3 * z_mm, angle_rad=radians(rotation_deg)
        )
        before = self.scene.state()
        self.scene.move_to(goal, ipc_steps=steps)
        if not self.scene.solved:
            _logger.warning("The twin found no solution between %s and %s and stays at the first.", self._axes, axes)
            self.scene.restore(before)
            return False
        self.scene.take_reports()
        self._axes = axes
        return True

    def wrench(self) -> Wrench:
        """Return force [N] and torque [N m] of what the sensor above the gripper carries, about the sensor's middle.

        Forces of the plate on the peg act where they touch; the rest, the peg's weight, acts at the grasp.
        """
        pairs, pose = self.scene.pair_forces(), self.scene.pose
        grasp_m = np.array((pose.x_m, pose.y_m, pose.z_m))
        sensor_m = np.array((pose.x_m, pose.y_m, pose.z_m + _SENSOR_ABOVE_M))
        is_on_peg = (pairs.bodies[:, 0] == _PEG) & (pairs.bodies[:, 1] == _PLATE)
        is_on_plate = (pairs.bodies[:, 1] == _PEG) & (pairs.bodies[:, 0] == _PLATE)
        forces_n = pairs.forces_n * (1.0 * is_on_peg - is_on_plate)[:, None]
        force_n = self.scene.contact_forces_n()[0]
        torque_nm = np.cross(pairs.points_m - sensor_m, forces_n).sum(axis=0)
        torque_nm += np.cross(grasp_m - sensor_m, force_n - forces_n.sum(axis=0))
        x, y, z, turn_x, turn_y, turn_z = np.concatenate((force_n, torque_nm)).tolist()
        return x, y, z, turn_x, turn_y, turn_z

    def depth_mm(self) -> float:
        """Return how deep the highest corner of the peg's lower end is below the rim [mm]."""
        return -float(self._peg.peg_relative_z_mm().max())


class _RaisedPeg(PegScene):
    """A peg that stands at a height above the plate."""

    def __init__(self, height_mm: float, *, start: PegStart, meshes: Meshes, settings: PegInsertionSettings,
                 clocks: Clocks) -> None:  # fmt: skip
        self._height_mm = height_mm
        super().__init__(start=start, meshes=meshes, settings=settings, clocks=clocks)

    def _lower_end_mm(self, offset: PegOffset) -> tuple[float, float, float]:
        x_mm, y_mm, z_mm = super()._lower_end_mm(offset)
        return x_mm, y_mm, z_mm + self._height_mm


def _settings(hidden: HiddenSettings) -> PegInsertionSettings:
    contact = ArenaContactSettings(
        pair_frictions=(
            PairFriction(first=GEL_MATERIAL, second=PART_MATERIAL, coefficient=hidden.gel_friction),
            PairFriction(first=PART_MATERIAL, second=PART_MATERIAL, coefficient=hidden.plate_friction),
            PairFriction(first=GEL_MATERIAL, second=GEL_MATERIAL, coefficient=hidden.gel_friction),
        )
    )
    return PegInsertionSettings(
        indentation_mm=hidden.indentation_mm,
        gripper_x_mm=hidden.grasp_x_mm,
        gripper_z_mm=-8.0 + hidden.grasp_z_mm,
        physics=PhysicsSettings(time_step_s=_TIME_STEP_S, contact=contact, youngs_modulus_pa=hidden.youngs_modulus_pa),
    )
