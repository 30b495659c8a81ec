"""Scene of the peg task: a peg held by two gels above a plate with its hole (challenge-facts 2.1)."""

from math import radians

import numpy as np
from numpy.typing import NDArray

from ...assets import Meshes
from ...deterministic_math import sine_cosine
from ...fem.model.bodies import RigidBody
from ...geometry.pegs import GRIPPED_WIDTH_MM, PEG_HEIGHT_MM, PLATE_THICKNESS_MM, bottom_vertices
from ...scene.grasped_scene import Clocks, GraspedScene, fixed_at_origin
from ...scene.gripper import GEL_HALF_THICKNESS_MM, UPRIGHT_MOUNTS, GripperPose
from ...scene.motion import ipc_steps
from .meshes import hole_mesh, peg_mesh
from .settings import PegInsertionSettings
from .task import PegState
from .variation import PegOffset, PegStart

# Free space before the grasp, between gel and peg and between peg and plate.
START_GAP_MM = 0.1
GRASP_SPEED_M_S = 5e-3
APPROACH_SPEED_M_S = 1e-3
TRAVEL_SPEED_M_S = 5e-3
TURN_SPEED_RAD_S = 0.2


class PegScene:
    """A peg scene, the commanded offset of the peg from its hole, and the gripper motions of the task.

    Attributes:
        grasped: the physics, the gripper and its sensors.
        env_steps: played so far in the episode.
        offset: commanded offset from the hole.
    """

    def __init__(self, *, start: PegStart, meshes: Meshes, settings: PegInsertionSettings, clocks: Clocks) -> None:
        self._settings = settings
        self._initial = start.offset
        self.offset: PegOffset = start.offset
        self.env_steps = 0
        peg = peg_mesh(meshes, start.shape)
        self._bottom = bottom_vertices(start.shape, peg)
        # Commanded height of the gripper, relative to the grasp.
        self._z_mm = 0.0
        self.grasped = GraspedScene(
            gel=meshes.gel(),
            held=self._placed_peg(peg_offset=start.offset, start=start, meshes=meshes),
            fixed=fixed_at_origin(hole_mesh(meshes, start.shape), friction=settings.hole_friction),
            mounts=UPRIGHT_MOUNTS,
            pose=self._open_pose(start.offset),
            physics=settings.physics,
            markers=settings.markers,
            clocks=clocks,
        )

    def grasp(self) -> None:
        """Close on the peg, take the references, and come down until the peg would stand one z step deep."""
        settings, grasped = self._settings, self.grasped
        closing_m = (START_GAP_MM + settings.indentation_mm) * 1e-3
        grasped.move_to(grasped.pose.moved(closing_m=closing_m), ipc_steps=self._ipc_steps(closing_m, GRASP_SPEED_M_S))
        grasped.capture_references()
        self._descend(START_GAP_MM + settings.z_step_mm, APPROACH_SPEED_M_S)

    def move(self, command: NDArray[np.float64]) -> None:
        """Update the commanded offset as an action says, and drive the gripper there."""
        self.travel(self._commanded(command))

    def travel(self, goal: PegOffset) -> None:
        """Move the gripper to an offset, x, y and theta together, then one z step down."""
        distance_m = max(abs(goal.x_mm - self.offset.x_mm), abs(goal.y_mm - self.offset.y_mm)) * 1e-3
        turn_rad = radians(goal.theta_deg - self.offset.theta_deg)
        steps = max(self._ipc_steps(distance_m, TRAVEL_SPEED_M_S), self._ipc_steps(turn_rad, TURN_SPEED_RAD_S))
        closing_m = self._closing_m(self.grasped.pose)
        self.offset = goal
        self.grasped.move_to(self._open_pose(goal).moved(z_m=self._z_mm * 1e-3, closing_m=closing_m), ipc_steps=steps)
        self._descend(self._settings.z_step_mm, TRAVEL_SPEED_M_S)

    def relative_motion_mm_deg(self) -> NDArray[np.float64]:
        """Commanded x, y, theta, z since the reset [mm, mm, deg, mm]; the descent of the reset is not counted."""
        now, initial = self.offset, self._initial
        descent_mm = -self.env_steps * self._settings.z_step_mm
        return np.array(
            [now.x_mm - initial.x_mm, now.y_mm - initial.y_mm, now.theta_deg - initial.theta_deg, descent_mm]
        )

    def state(self) -> PegState:
        """Return what the env step that was just played is judged by."""
        return PegState(
            env_steps=self.env_steps,
            offset=self.offset,
            surface_diff_m=self.grasped.surface_diff_m(),
            peg_relative_z_mm=self.peg_relative_z_mm(),
        )

    def peg_relative_z_mm(self) -> NDArray[np.float64]:
        """Return the height of the peg's bottom corners above the plate's upper face [mm], in the order of the logs."""
        return self.grasped.held_vertices_m(self._bottom)[:, 2] * 1e3 - PLATE_THICKNESS_MM

    def _commanded(self, command: NDArray[np.float64]) -> PegOffset:
        """Return the offset after an action: scaled, clipped, and x and y turned by the angle before the env step."""
        scale = np.array(self._settings.action_scale_mm_deg)
        dx, dy, dtheta = np.clip(command * scale, -scale, scale).tolist()
        sine, cosine = sine_cosine(radians(self.offset.theta_deg))
        return PegOffset(
            x_mm=self.offset.x_mm + (dx * cosine - dy * sine),
            y_mm=self.offset.y_mm + (dx * sine + dy * cosine),
            theta_deg=self.offset.theta_deg + dtheta,
        )

    def _descend(self, distance_mm: float, speed_m_s: float) -> None:
        self._z_mm -= distance_mm
        distance_m = distance_mm * 1e-3
        self.grasped.move_to(self.grasped.pose.moved(z_m=-distance_m), ipc_steps=self._ipc_steps(distance_m, speed_m_s))

    def _ipc_steps(self, amount: float, speed_per_s: float) -> int:
        return ipc_steps(amount, speed_per_s=speed_per_s, time_step_s=self._settings.physics.time_step_s)

    def _closing_m(self, pose: GripperPose) -> float:
        return _open_half_m() - pose.half_opening_m

    def _open_pose(self, offset: PegOffset) -> GripperPose:
        """Return the pose of the gripper around the peg before the grasp, at the height of the grasp."""
        angle_rad = radians(offset.theta_deg)
        sine, cosine = sine_cosine(angle_rad)
        along_mm = self._settings.gripper_x_mm
        height_mm = PEG_HEIGHT_MM + PLATE_THICKNESS_MM + START_GAP_MM + self._settings.gripper_z_mm
        return GripperPose(
            x_m=(offset.x_mm + cosine * along_mm) * 1e-3,
            y_m=(offset.y_mm + sine * along_mm) * 1e-3,
            z_m=height_mm * 1e-3,
            angle_rad=angle_rad,
            half_opening_m=_open_half_m(),
        )

    def _placed_peg(self, *, peg_offset: PegOffset, start: PegStart, meshes: Meshes) -> RigidBody:
        sine, cosine = sine_cosine(radians(peg_offset.theta_deg))
        return RigidBody(
            mesh=peg_mesh(meshes, start.shape),
            rotation=np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]]),
            translation_m=np.array([peg_offset.x_mm, peg_offset.y_mm, PLATE_THICKNESS_MM + START_GAP_MM]) * 1e-3,
            density_kg_m3=self._settings.physics.rigid_density_kg_m3,
            friction=self._settings.peg_friction,
        )


def _open_half_m() -> float:
    return (0.5 * GRIPPED_WIDTH_MM + GEL_HALF_THICKNESS_MM + START_GAP_MM) * 1e-3
