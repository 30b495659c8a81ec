"""The twin's peg, gels and plate: the simulation of the envs, driven by where the stage and the gripper really are."""

import logging
from dataclasses import dataclass
from math import ceil, cos, radians, sin
from typing import Any, Final, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray
from vitac.envs.assets import Meshes
from vitac.envs.fem.model.mesh import GEL_MATERIAL, PART_MATERIAL, PronyBranch
from vitac.envs.fem.model.settings import ArenaContactSettings, FrictionWeakening, PairFriction
from vitac.envs.geometry.bases import RIM_MM
from vitac.envs.geometry.keys_and_locks import KEYS, LOCKS, OWN_CLEARANCE, KeyShape
from vitac.envs.geometry.pegs import PegShape
from vitac.envs.scene.grasped_scene import Clocks, PhysicsSettings, Stopwatch
from vitac.envs.scene.gripper import GripperPose
from vitac.envs.tasks.fusion_insertion.env import START_GAP_MM as FUSION_GAP_MM
from vitac.envs.tasks.fusion_insertion.env import (
    Z_TARGET_MM,
    FusionInsertionSettings,
    FusionOffset,
    FusionScene,
    FusionShape,
    FusionStart,
    RigVariation,
    Target,
)
from vitac.envs.tasks.insertion.env import InsertionScene
from vitac.envs.tasks.insertion.interface import PegOffset
from vitac.envs.tasks.lock_opening.env import KeyOffset, LockOpeningSettings, LockScene, LockStart, SensorJitter
from vitac.envs.tasks.peg_insertion.env import PegInsertionSettings, PegScene, PegStart
from vitac.envs.vision.camera import Sight
from vitac.envs.vision.pinhole import RigShift

from ..description import StationTask
from .hidden import HiddenSettings
from .structure import Compliance, Tilt

_logger = logging.getLogger(__name__)

Axes = tuple[float, float, float, float]
Wrench = tuple[float, float, float, float, float, float]

TIME_STEP_S: Final = 0.04
_CREEP: Final = 4.0
"""After as many of its longest relaxation times a gel at rest has crept."""
_WAY_MM: Final = 0.5
"""Longest way in one IPC step."""
_TURN_DEG: Final = 1.0
GRIP_MM: Final = -8.0
"""Of the gripper from the peg's upper end."""
_PEG, _PLATE = 2, 3
"""Their numbers among the bodies of the scene: the gels are the first two."""
_FLATTEST_MM, _DEEPEST_MM = 0.02, 1.5
_SENSOR_ABOVE_M: Final = 0.15
"""Middle of the force/torque sensor above the grasp: the length of a Hand-E and its flange."""


HOLE: Final[Axes] = (0.0, 0.0, -40.0, 0.0)
"""Where the stage is while a centred peg stands on the plate, or holds a key that is deepest in its lock."""
_GARAGE: Final[Axes] = (-55.0, 0.0, -30.0, 0.0)
_LOCK_GARAGE: Final[Axes] = (75.0, 0.0, -40.0, 0.0)
"""In front of the lock, out of which the longest key comes 56 mm from where it is deepest."""
_CLEAR_MM, _KEY_CLEAR_MM = 2.0, 60.0


class Mounted(NamedTuple):
    """What stands before the gripper: the parts of a task, by its name, and the shape of the peg or key."""

    task: StationTask = StationTask.PEG
    shape: str = PegShape.CUBOID

    @property
    def garage(self) -> Axes:
        """Where the stage is while the gripper can close on the peg, or on the middle of the key's handle."""
        return _LOCK_GARAGE if self.task is StationTask.LOCK else _GARAGE

    def is_clear(self, at: Axes) -> bool:
        """Return whether what the gripper holds cannot touch what it goes into."""
        if self.task is StationTask.LOCK:
            return at[0] > HOLE[0] + _KEY_CLEAR_MM
        return at[2] > HOLE[2] + _CLEAR_MM


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


class FingerSprings:
    """Springs of both fingers along the direction in which they close."""

    def __init__(self, compliance: Compliance) -> None:
        self._n_m = 1e3 * compliance.finger_n_mm
        self._opened_m, self._shifted_m = 0.0, 0.0

    def give(self, pose: GripperPose, gel_forces_n: NDArray[np.float64]) -> GripperPose:
        """Return where a pose gives way to; half of the rest of the way each time, so that it settles.

        Args:
            pose: of rigid fingers.
            gel_forces_n: of contacts on the left and the right gel, shape [2, 3].
        """
        closing = np.array((-sin(pose.angle_rad), cos(pose.angle_rad), 0.0))
        left, right = gel_forces_n @ closing
        self._opened_m += 0.5 * (0.5 * (left - right) / self._n_m - self._opened_m)
        self._shifted_m += 0.5 * (0.5 * (left + right) / self._n_m - self._shifted_m)
        x_m, y_m, _ = self._shifted_m * closing
        return pose.moved(x_m=x_m, y_m=y_m, closing_m=-self._opened_m)


def grip_harder(hidden: HiddenSettings, factor: float) -> HiddenSettings:
    """Return a twin whose gripper closes with a multiple of its force: the gels give way in proportion."""
    indentation_mm = min(max(hidden.indentation_mm * factor, _FLATTEST_MM), _DEEPEST_MM)
    return hidden.model_copy(update={"indentation_mm": indentation_mm})


def in_world(at: Axes, hole: Axes, hidden: HiddenSettings) -> Axes:
    """Return where a stage really is, relative to the hole that its file has elsewhere."""
    x_mm, y_mm, turn_deg = hidden.origin
    x, y, z, rotation_deg = (value - there for value, there in zip(at, hole, strict=True))
    return x + x_mm, y + y_mm, z - hidden.plate_mm, rotation_deg + turn_deg


class HeldPeg:
    """A peg or key between two gels, from its grasp until it is released.

    Attributes:
        scene: gels, peg and plate, or key and lock.
        axes: where the stage is, from the hole.
    """

    def __init__(self, peg: InsertionScene[Any, Any] | LockScene, axes: Axes, fingers: Compliance | None) -> None:
        """Close on what stands where the gripper is."""
        self._peg = peg
        if isinstance(peg, LockScene):
            peg.grasp()
        else:
            InsertionScene.grasp(peg)  # that of the task goes down to the plate, too
        self.scene = self._peg.grasped
        self._start = _Grasp(axes=axes, pose=self.scene.pose)
        self.axes = axes
        relaxation_s = max((branch.relaxation_time_s for branch in self.scene.physics.viscosity), default=0.0)
        self._creeping_steps = round(_CREEP * relaxation_s / self.scene.physics.time_step_s)
        self._rest_steps = 0
        self._springs = fingers and FingerSprings(fingers)

    def follow(self, axes: Axes, way_mm: float = _WAY_MM) -> bool:
        """Move the gripper with the stage, in IPC steps of at most a way; return whether anything moved.

        A viscous gel moves at rest, too, until its branches have relaxed. Where the physics finds no solution nothing
        moves, and the next call tries again.
        """
        self._rest_steps = self._rest_steps + 1 if axes == self.axes else 0
        if self._rest_steps > self._creeping_steps:
            return False
        farthest_mm = max(abs(a - b) for a, b in zip(axes[:3], self.axes[:3], strict=True))
        steps = max(1, ceil(farthest_mm / way_mm), ceil(abs(axes[3] - self.axes[3]) / _TURN_DEG))
        x_mm, y_mm, z_mm, rotation_deg = (now - before for now, before in zip(axes, self._start.axes, strict=True))
        goal = self._start.pose.moved(
            x_m=1e-3 * x_mm, y_m=1e-3 * y_mm, z_m=1e-3 * z_mm, angle_rad=radians(rotation_deg)
        )
        if self._springs:
            goal = self._springs.give(goal, self.scene.contact_forces_n()[1:])
        before = self.scene.state()
        self.scene.move_to(goal, ipc_steps=steps)
        if not self.scene.solved:
            _logger.warning("The twin found no solution between %s and %s and stays at the first.", self.axes, axes)
            self.scene.restore(before)
            return False
        self.scene.take_reports()
        self.axes = axes
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
        x, y, z, rotation = (now - before for now, before in zip(self.axes, self._start.axes, strict=True))
        return self._peg.look_from(x, y, rotation, z)


def hold_peg(
    mounted: "Mounted", axes: Axes, hidden: HiddenSettings, meshes: Meshes, period_s: float = TIME_STEP_S
) -> HeldPeg:
    """Return the mounted peg in the gripper, where that is now, or the key, which is in its garage.

    Args:
        mounted: what is held.
        axes: of the stage, from the hole.
        hidden: what it is really like.
        meshes: of the gels and the parts.
        period_s: time between two calls of `HeldPeg.follow`, as long as an IPC step of viscous gels.
    """
    structure = hidden.structure
    physics = _physics(hidden, period_s if structure.viscosity or structure.weakening else TIME_STEP_S)
    x_mm, y_mm, z_mm, rotation_deg = axes
    clocks = Clocks(physics=Stopwatch(), markers=Stopwatch())
    # The peg stands where the gripper is, but for the grasp.
    x_mm, z_mm = x_mm - hidden.grasp_x_mm, z_mm - hidden.grasp_z_mm
    if mounted.task is StationTask.LOCK:
        return HeldPeg(_lock_scene(mounted, axes, hidden, meshes, physics, clocks), axes, structure.compliance)
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
                settings=_settings(FusionInsertionSettings, hidden, physics),
                clocks=clocks,
                rig=_rig(hidden),
            ),
            axes,
            structure.compliance,
        )
    offset = PegOffset(x_mm=x_mm, y_mm=y_mm, theta_deg=rotation_deg)
    raised = PegScene(
        start=PegStart(shape=PegShape(mounted.shape), offset=offset),
        meshes=meshes,
        settings=_settings(PegInsertionSettings, hidden, physics),
        clocks=clocks,
        gap_mm=z_mm,
    )
    return HeldPeg(raised, axes, structure.compliance)


def _lock_scene(
    mounted: Mounted, axes: Axes, hidden: HiddenSettings, meshes: Meshes, physics: PhysicsSettings, clocks: Clocks
) -> LockScene:
    """Return gels that are open around the handle of a key in its garage; key and gripper turn together."""
    shape = KeyShape(mounted.shape)
    key = in_world(mounted.garage, HOLE, hidden)
    return LockScene(
        start=LockStart(
            shape=shape,
            offset=KeyOffset(x_mm=key[0], y_mm=key[1], z_mm=key[2]),
            jitter=SensorJitter(x_mm=axes[0] - key[0], z_mm=axes[2] - key[2]),
        ),
        meshes=meshes,
        settings=LockOpeningSettings(
            slot_clearance_mm=_slot_clearance_mm(shape, hidden.structure.tolerance_mm),
            indentation_mm=hidden.indentation_mm,
            gripper_x_mm=hidden.grasp_x_mm,
            gripper_z_mm=hidden.grasp_z_mm,
            physics=physics,
        ),
        clocks=clocks,
    )


def _slot_clearance_mm(shape: KeyShape, tolerance_mm: float) -> float:
    """Return the room of a tooth in its slot on both sides of a lock that was made with a tolerance."""
    if not tolerance_mm:
        return OWN_CLEARANCE
    (slot_from, slot_to), (tooth_from, tooth_to) = LOCKS[shape].slots_mm[0], KEYS[shape].teeth_mm[0]
    return 0.5 * ((slot_to - slot_from) - (tooth_to - tooth_from)) + tolerance_mm


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


def _settings(kind: type[_Settings], hidden: HiddenSettings, physics: PhysicsSettings) -> _Settings:
    tilt = hidden.structure.tilt or Tilt(peg_deg=0.0, plate_deg=(0.0, 0.0))
    hole_tilt_x_deg, hole_tilt_y_deg = tilt.plate_deg
    return kind(
        clearance_mm=kind.clearance_mm + hidden.structure.tolerance_mm,
        indentation_mm=hidden.indentation_mm,
        gripper_x_mm=hidden.grasp_x_mm,
        gripper_z_mm=GRIP_MM + hidden.grasp_z_mm,
        peg_tilt_deg=tilt.peg_deg,
        hole_tilt_x_deg=hole_tilt_x_deg,
        hole_tilt_y_deg=hole_tilt_y_deg,
        physics=physics,
    )


def _physics(hidden: HiddenSettings, time_step_s: float) -> PhysicsSettings:
    structure, law = hidden.structure, hidden.structure.weakening
    contact = ArenaContactSettings(
        pair_frictions=(
            PairFriction(first=GEL_MATERIAL, second=PART_MATERIAL, coefficient=hidden.gel_friction),
            PairFriction(first=PART_MATERIAL, second=PART_MATERIAL, coefficient=hidden.plate_friction),
            PairFriction(first=GEL_MATERIAL, second=GEL_MATERIAL, coefficient=hidden.gel_friction),
        ),
        weakening=FrictionWeakening(law.kinetic_ratio, 1e-3 * law.speed_mm_s) if law else None,
    )
    return PhysicsSettings(
        time_step_s=time_step_s,
        contact=contact,
        youngs_modulus_pa=hidden.youngs_modulus_pa,
        poisson_ratio=hidden.poisson_ratio,
        viscosity=tuple(PronyBranch(**branch.model_dump()) for branch in structure.viscosity),
        yeoh=structure.yeoh or (0.0, 0.0),
    )


def _rig(hidden: HiddenSettings) -> RigVariation:
    x_mm, z_mm, turn_deg = hidden.rig
    shift = RigShift(turn_rad=radians(turn_deg), offset_m=(1e-3 * x_mm, 0.0, 1e-3 * z_mm))
    return RigVariation(shift=shift, noise_seed=hidden.left.seed)
