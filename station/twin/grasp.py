"""The twin's peg, gels and plate: the simulation of the envs, driven by where the stage and the gripper really are."""

import logging
from dataclasses import dataclass
from math import ceil, radians
from typing import Any, Final, NamedTuple, TypeVar

import numpy as np
from vitac.envs.assets import Meshes
from vitac.envs.fem.model.mesh import GEL_MATERIAL, PART_MATERIAL
from vitac.envs.fem.model.settings import ArenaContactSettings, PairFriction
from vitac.envs.geometry.bases import RIM_MM
from vitac.envs.geometry.pegs import PegShape
from vitac.envs.scene.grasped_scene import Clocks, PhysicsSettings, Stopwatch
from vitac.envs.scene.gripper import GripperPose
from vitac.envs.tasks.fusion_insertion.scene import START_GAP_MM as FUSION_GAP_MM
from vitac.envs.tasks.fusion_insertion.scene import (
    Z_TARGET_MM,
    FusionInsertionSettings,
    FusionOffset,
    FusionScene,
    FusionShape,
    FusionStart,
    RigVariation,
    Target,
)
from vitac.envs.tasks.insertion.interface import PegOffset
from vitac.envs.tasks.insertion.scene import InsertionScene
from vitac.envs.tasks.peg_insertion.scene import START_GAP_MM, PegInsertionSettings, PegScene, PegStart
from vitac.envs.vision.camera import Sight
from vitac.envs.vision.pinhole import RigShift

from ..description import StationTask
from .hidden import HiddenSettings

_logger = logging.getLogger(__name__)

Axes = tuple[float, float, float, float]
Wrench = tuple[float, float, float, float, float, float]

_TIME_STEP_S: Final = 0.04
_WAY_MM: Final = 0.5
"""Longest way in one IPC step."""
_TURN_DEG: Final = 1.0
_GRIP_MM: Final = -8.0
"""Of the gripper from the peg's upper end."""
_PEG, _PLATE = 2, 3
"""Their numbers among the bodies of the scene: the gels are the first two."""
_SENSOR_ABOVE_M: Final = 0.15
"""Middle of the force/torque sensor above the grasp: the length of a Hand-E and its flange."""


class Mounted(NamedTuple):
    """What stands before the gripper: the parts of a task, by its name, and the shape of the peg."""

    task: StationTask = StationTask.PEG
    shape: str = PegShape.CUBOID


CUBOID_PEG: Final = Mounted()


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

    def __init__(self, peg: InsertionScene[Any, Any], axes: Axes) -> None:
        """Close on a peg that stands upright where the gripper is."""
        self._peg = peg
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

    def look(self) -> Sight | None:
        """Return what an RGB-D camera beside the gripper sees now; None where the scene has none."""
        if not isinstance(self._peg, _SeenPeg):
            return None
        x, y, z, rotation = (now - before for now, before in zip(self._axes, self._start.axes, strict=True))
        return self._peg.look_from(x, y, rotation, z)

    def depth_mm(self) -> float:
        """Return how deep the highest corner of the peg's lower end is below the rim [mm]."""
        return -float(self._peg.peg_relative_z_mm().max())


def hold_peg(mounted: "Mounted", axes: Axes, hidden: HiddenSettings, meshes: Meshes) -> HeldPeg:
    """Return the mounted peg in the gripper, where that is now."""
    x_mm, y_mm, z_mm, rotation_deg = axes
    clocks = Clocks(physics=Stopwatch(), markers=Stopwatch())
    # The peg stands where the gripper is, but for the grasp.
    x_mm, z_mm = x_mm - hidden.grasp_x_mm, z_mm - hidden.grasp_z_mm
    if mounted.task is StationTask.FUSION:
        target = Target.from_shape(FusionShape(mounted.shape))
        place = FusionOffset(
            x_mm=x_mm,
            y_mm=y_mm - target.y_mm,
            theta_deg=rotation_deg,
            z_mm=z_mm + RIM_MM - Z_TARGET_MM - FUSION_GAP_MM,
        )
        start = FusionStart(offset=place, target=target)
        return HeldPeg(
            _SeenPeg(
                start=start,
                meshes=meshes,
                settings=_settings(FusionInsertionSettings, hidden),
                clocks=clocks,
                rig=_rig(hidden),
            ),
            axes,
        )
    offset = PegOffset(x_mm=x_mm, y_mm=y_mm, theta_deg=rotation_deg)
    raised = _RaisedPeg(
        z_mm - START_GAP_MM,  # PegScene places it above the plate's face
        start=PegStart(shape=PegShape(mounted.shape), offset=offset),
        meshes=meshes,
        settings=_settings(PegInsertionSettings, hidden),
        clocks=clocks,
    )
    return HeldPeg(raised, axes)


class _RaisedPeg(PegScene):
    """A peg that stands at a height above the plate."""

    def __init__(self, height_mm: float, *, start: PegStart, meshes: Meshes, settings: PegInsertionSettings,
                 clocks: Clocks) -> None:  # fmt: skip
        self._height_mm = height_mm
        super().__init__(start=start, meshes=meshes, settings=settings, clocks=clocks)

    def _lower_end_mm(self, offset: PegOffset) -> tuple[float, float, float]:
        x_mm, y_mm, z_mm = super()._lower_end_mm(offset)
        return x_mm, y_mm, z_mm + self._height_mm


class _SeenPeg(FusionScene):
    """A peg above the base with two holes, at which a camera looks that moves with the stage."""

    def look_from(self, x_mm: float, y_mm: float, theta_deg: float, z_mm: float) -> Sight:
        """Return what the camera sees after a motion since the grasp."""
        start = self._initial
        self.offset = FusionOffset(
            x_mm=start.x_mm + x_mm,
            y_mm=start.y_mm + y_mm,
            theta_deg=start.theta_deg + theta_deg,
            z_mm=start.z_mm + z_mm,
        )
        self.env_steps, self._sight = self.env_steps + 1, None  # the noise is another one each time
        return self.sight()


_Settings = TypeVar("_Settings", PegInsertionSettings, FusionInsertionSettings)


def _settings(kind: type[_Settings], hidden: HiddenSettings) -> _Settings:
    return kind(
        indentation_mm=hidden.indentation_mm,
        gripper_x_mm=hidden.grasp_x_mm,
        gripper_z_mm=_GRIP_MM + hidden.grasp_z_mm,
        physics=_physics(hidden),
    )


def _physics(hidden: HiddenSettings) -> PhysicsSettings:
    contact = ArenaContactSettings(
        pair_frictions=(
            PairFriction(first=GEL_MATERIAL, second=PART_MATERIAL, coefficient=hidden.gel_friction),
            PairFriction(first=PART_MATERIAL, second=PART_MATERIAL, coefficient=hidden.plate_friction),
            PairFriction(first=GEL_MATERIAL, second=GEL_MATERIAL, coefficient=hidden.gel_friction),
        )
    )
    return PhysicsSettings(
        time_step_s=_TIME_STEP_S,
        contact=contact,
        youngs_modulus_pa=hidden.youngs_modulus_pa,
        poisson_ratio=hidden.poisson_ratio,
    )


def _rig(hidden: HiddenSettings) -> RigVariation:
    x_mm, z_mm, turn_deg = hidden.rig
    shift = RigShift(turn_rad=radians(turn_deg), offset_m=(1e-3 * x_mm, 0.0, 1e-3 * z_mm))
    return RigVariation(shift=shift, noise_seed=hidden.left.seed)
