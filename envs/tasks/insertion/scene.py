"""A peg held upright by two gels above its hole: placing, grasping, driving and measuring it."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from math import radians
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from ...deterministic_math import sine_cosine
from ...fem.model.mesh import GelMesh, RigidBody, SurfaceMesh
from ...geometry.pegs import GRIPPED_WIDTH_MM, PEG_HEIGHT_MM
from ...scene.grasped_scene import Clocks, GraspedScene
from ...scene.gripper import UPRIGHT_MOUNTS, Gripper, GripperPose, ipc_steps
from ...tactile.gel import highest_mm
from ...tactile.sensor import TactileSensor
from .settings import InsertionSettings
from .state import InsertionState, OffsetT

FloatArray = NDArray[np.float64]
SettingsT = TypeVar("SettingsT", bound=InsertionSettings)

# Free space between gel and peg before the grasp.
GRASP_GAP_MM = 0.1
GRASP_SPEED_M_S = 5e-3
TRAVEL_SPEED_M_S = 5e-3
TURN_SPEED_RAD_S = 0.2


@dataclass(frozen=True, kw_only=True, eq=False)
class Parts:
    """What a scene is made of.

    Attributes:
        sensors: left and right, with the same gel.
        peg: its surface.
        peg_bottom: vertices of the peg at its lower corners, in the order of the logs, shape [n].
        fixed: the part with the hole.
        rim_mm: height of the hole's rim [mm].
    """

    sensors: tuple[TactileSensor, TactileSensor]
    peg: SurfaceMesh
    peg_bottom: NDArray[np.int64]
    fixed: RigidBody
    rim_mm: float

    @property
    def gel(self) -> GelMesh:
        """Gel of both sensors."""
        return self.sensors[0].gel


class InsertionScene(ABC, Generic[OffsetT, SettingsT]):
    """A peg scene, and the commanded offset of the peg from its hole.

    Attributes:
        grasped: the physics, the gripper and its sensors.
        env_steps: played so far in the episode.
        offset: commanded offset from the hole.
    """

    def __init__(self, parts: Parts, *, offset: OffsetT, settings: SettingsT, clocks: Clocks) -> None:
        self._parts, self._settings = parts, settings
        self._initial = offset
        self.offset: OffsetT = offset
        self.env_steps = 0
        self.grasped = GraspedScene(
            gripper=Gripper(mounts=UPRIGHT_MOUNTS, gel=parts.gel, pose=self._open_pose(offset)),
            held=self._placed_peg(),
            fixed=parts.fixed,
            physics=settings.physics,
            sensors=parts.sensors,
            clocks=clocks,
        )

    @abstractmethod
    def move(self, command: FloatArray) -> None:
        """Update the commanded offset as an action says, and drive the gripper there."""

    @abstractmethod
    def _lower_end_mm(self, offset: OffsetT) -> tuple[float, float, float]:
        """Return where the middle of the peg's lower end is at an offset, without the task's own descent [mm]."""

    def grasp(self) -> None:
        """Close on the peg in free air, and take the references."""
        closing_m = (GRASP_GAP_MM + self._settings.indentation_mm) * 1e-3
        goal = self.grasped.pose.moved(closing_m=closing_m)
        self.grasped.move_to(goal, ipc_steps=self._ipc_steps(closing_m, GRASP_SPEED_M_S))
        self.grasped.capture_references()

    def relative_motion_mm_deg(self) -> FloatArray:
        """Return the commanded motion of every number of the offset since the reset [mm, deg]."""
        return self.offset.as_array() - self._initial.as_array()

    def state(self) -> InsertionState[OffsetT]:
        """Return what the env step that was just played is judged by."""
        return InsertionState(
            env_steps=self.env_steps,
            offset=self.offset,
            surface_diff_m=self.grasped.surface_diff_m(),
            peg_relative_z_mm=self.peg_relative_z_mm(),
        )

    @property
    def measured_vertices(self) -> NDArray[np.int64]:
        """Vertices of the peg whose heights are measured."""
        return self._parts.peg_bottom

    def peg_relative_z_mm(self) -> FloatArray:
        """Return the height of the peg's bottom corners above the rim [mm], in the order of the logs."""
        return self.grasped.held_vertices_m(self._parts.peg_bottom)[:, 2] * 1e3 - self._parts.rim_mm

    def _scaled(self, command: FloatArray) -> list[float]:
        """Return an action in mm and degrees, clipped, with x and y turned by the angle before the env step."""
        scale = np.array(self._settings.action_scale_mm_deg)
        dx, dy, *others = np.clip(command * scale, -scale, scale).tolist()
        sine, cosine = sine_cosine(radians(self.offset.theta_deg))
        return [dx * cosine - dy * sine, dx * sine + dy * cosine, *others]

    def _travel(self, goal: OffsetT, distance_mm: float, *, raised_mm: float = 0.0) -> None:
        """Drive the grasped peg to an offset, all axes together.

        Args:
            goal: new commanded offset.
            distance_mm: longest way along an axis.
            raised_mm: height above that of the offset.
        """
        turn_rad = radians(goal.theta_deg - self.offset.theta_deg)
        steps = max(self._ipc_steps(distance_mm * 1e-3, TRAVEL_SPEED_M_S), self._ipc_steps(turn_rad, TURN_SPEED_RAD_S))
        closing_m = self._open_half_m() - self.grasped.pose.half_opening_m
        self.offset = goal
        pose = self._open_pose(goal).moved(z_m=raised_mm * 1e-3, closing_m=closing_m)
        self.grasped.move_to(pose, ipc_steps=steps)

    def _ipc_steps(self, amount: float, speed_per_s: float) -> int:
        return ipc_steps(amount, speed_per_s=speed_per_s, time_step_s=self._settings.physics.time_step_s)

    def _placed_peg(self) -> RigidBody:
        """Return the peg at the commanded offset, upright."""
        sine, cosine = sine_cosine(radians(self.offset.theta_deg))
        return RigidBody(
            mesh=self._parts.peg,
            rotation=np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]]),
            translation_m=np.array(self._lower_end_mm(self.offset)) * 1e-3,
            density_kg_m3=self._settings.physics.rigid_density_kg_m3,
            friction=self._settings.peg_friction,
        )

    def _open_pose(self, offset: OffsetT) -> GripperPose:
        """Return the pose of the gripper around the peg at an offset before the grasp."""
        angle_rad = radians(offset.theta_deg)
        sine, cosine = sine_cosine(angle_rad)
        along_mm = self._settings.gripper_x_mm
        x_mm, y_mm, z_mm = self._lower_end_mm(offset)
        return GripperPose(
            x_m=(x_mm + cosine * along_mm) * 1e-3,
            y_m=(y_mm + sine * along_mm) * 1e-3,
            z_m=(z_mm + PEG_HEIGHT_MM + self._settings.gripper_z_mm) * 1e-3,
            angle_rad=angle_rad,
            half_opening_m=self._open_half_m(),
        )

    def _open_half_m(self) -> float:
        """Return the distance of the gels' origins from the gripper's before the grasp [m]."""
        return (0.5 * GRIPPED_WIDTH_MM + highest_mm(self._parts.gel) + GRASP_GAP_MM) * 1e-3
