"""Scene of the fusion task: a peg held by two gels above a base with two holes, and the rig (challenge-facts 2.3)."""

from math import radians

import numpy as np
from numpy.typing import NDArray

from ...assets import Meshes
from ...deterministic_math import sine_cosine
from ...fem.model.bodies import RigidBody
from ...geometry.bases import RIM_MM
from ...geometry.pegs import GRIPPED_WIDTH_MM, PEG_HEIGHT_MM
from ...scene.grasped_scene import Clocks, GraspedScene, fixed_at_origin
from ...scene.gripper import GEL_HALF_THICKNESS_MM, UPRIGHT_MOUNTS, GripperPose
from ...scene.motion import ipc_steps
from ...vision.camera import DepthMode, RigCamera, Sight
from ...vision.rig import RigShift, colour_camera_pose
from ...vision.surfaces import Body, Label
from .meshes import base_mesh, peg_bottom, peg_mesh
from .settings import FusionInsertionSettings
from .task import FusionState
from .variation import START_GAP_MM, Z_TARGET_MM, FusionOffset, FusionStart, Target

# Free space between gel and peg before the grasp.
GRASP_GAP_MM = 0.1
GRASP_SPEED_M_S = 5e-3
TRAVEL_SPEED_M_S = 5e-3
TURN_SPEED_RAD_S = 0.2


class FusionScene:
    """A fusion scene, the commanded offset of the peg from the right hole, and what the rig sees.

    Attributes:
        grasped: the physics, the gripper and its sensors.
        env_steps: played so far in the episode.
        offset: commanded offset from the right hole.
        target: which hole is the right one.
    """

    def __init__(
        self,
        *,
        start: FusionStart,
        meshes: Meshes,
        settings: FusionInsertionSettings,
        clocks: Clocks,
        rig_shift: RigShift,
    ) -> None:
        self._settings, self._rig_shift = settings, rig_shift
        self._initial = start.offset
        self.offset: FusionOffset = start.offset
        self.target: Target = start.target
        self.env_steps = 0
        peg = peg_mesh(meshes, start.target)
        self._bottom = peg_bottom(peg, start.target)
        self.grasped = GraspedScene(
            gel=meshes.gel(),
            held=self._placed_peg(meshes),
            fixed=fixed_at_origin(base_mesh(meshes, settings.clearance_mm), friction=settings.base_friction),
            mounts=UPRIGHT_MOUNTS,
            pose=self._open_pose(start.offset),
            physics=settings.physics,
            markers=settings.markers,
            clocks=clocks,
        )
        self._rig = RigCamera(self._visible_bodies(), DepthMode(settings.depth_mode))
        self._sight: Sight | None = None

    def grasp(self) -> None:
        """Close on the peg in free air, and take the references."""
        grasped = self.grasped
        closing_m = (GRASP_GAP_MM + self._settings.indentation_mm) * 1e-3
        grasped.move_to(grasped.pose.moved(closing_m=closing_m), ipc_steps=self._ipc_steps(closing_m, GRASP_SPEED_M_S))
        grasped.capture_references()
        self._sight = None

    def move(self, command: NDArray[np.float64]) -> None:
        """Update the commanded offset as an action says, and drive the gripper there, all axes together."""
        goal = self._commanded(command)
        now = self.offset
        distance_mm = max(abs(goal.x_mm - now.x_mm), abs(goal.y_mm - now.y_mm), abs(goal.z_mm - now.z_mm))
        turn_rad = radians(goal.theta_deg - now.theta_deg)
        steps = max(self._ipc_steps(distance_mm * 1e-3, TRAVEL_SPEED_M_S), self._ipc_steps(turn_rad, TURN_SPEED_RAD_S))
        closing_m = _open_half_m() - self.grasped.pose.half_opening_m
        self.offset = goal
        self._sight = None
        self.grasped.move_to(self._open_pose(goal).moved(closing_m=closing_m), ipc_steps=steps)

    def sight(self, random: np.random.Generator) -> Sight:
        """Return what the rig sees now; looked at once, however often it is asked for before the next motion."""
        if self._sight is None:
            grasped = self.grasped
            peg_m = grasped.held_vertices_m(np.arange(len(grasped.held.mesh.vertices_m)))
            positions_m = [grasped.fixed.mesh.vertices_m, peg_m, grasped.gel_nodes_m(0), grasped.gel_nodes_m(1)]
            y_m = (self.offset.y_mm + self.target.y_mm) * 1e-3
            z_m = (self.offset.z_mm + Z_TARGET_MM) * 1e-3
            self._sight = self._rig.look(positions_m, colour_camera_pose(y_m, z_m, self._rig_shift), random)
        return self._sight

    def relative_motion_mm_deg(self) -> NDArray[np.float64]:
        """Return the commanded x, y, theta, z since the grasp [mm, mm, deg, mm]."""
        return self.offset.as_array() - self._initial.as_array()

    def state(self) -> FusionState:
        """Return what the env step that was just played is judged by."""
        return FusionState(
            env_steps=self.env_steps,
            offset=self.offset,
            surface_diff_m=self.grasped.surface_diff_m(),
            peg_relative_z_mm=self.peg_relative_z_mm(),
        )

    def peg_relative_z_mm(self) -> NDArray[np.float64]:
        """Return the height of the peg's bottom corners above the rim [mm], in the order of the logs."""
        return self.grasped.held_vertices_m(self._bottom)[:, 2] * 1e3 - RIM_MM

    def _commanded(self, command: NDArray[np.float64]) -> FusionOffset:
        """Return the offset after an action: scaled, clipped, and x and y turned by the angle before the env step."""
        scale = np.array(self._settings.action_scale_mm_deg)
        dx, dy, dtheta, dz = np.clip(command * scale, -scale, scale).tolist()
        sine, cosine = sine_cosine(radians(self.offset.theta_deg))
        return FusionOffset(
            x_mm=self.offset.x_mm + (dx * cosine - dy * sine),
            y_mm=self.offset.y_mm + (dx * sine + dy * cosine),
            theta_deg=self.offset.theta_deg + dtheta,
            z_mm=self.offset.z_mm + dz,
        )

    def _placed_peg(self, meshes: Meshes) -> RigidBody:
        """Return the peg at the commanded offset, upright."""
        offset = self.offset
        sine, cosine = sine_cosine(radians(offset.theta_deg))
        return RigidBody(
            mesh=peg_mesh(meshes, self.target),
            rotation=np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]]),
            translation_m=np.array([offset.x_mm, offset.y_mm + self.target.y_mm, _lower_end_mm(offset)]) * 1e-3,
            density_kg_m3=self._settings.physics.rigid_density_kg_m3,
            friction=self._settings.peg_friction,
        )

    def _visible_bodies(self) -> list[Body]:
        """Return base, peg and both gels, in the order in which `sight` gives their positions."""
        grasped = self.grasped
        solids = ((grasped.fixed.mesh, Label.BASE), (grasped.held.mesh, Label.PEG))
        gel = grasped.gel
        return [
            *(Body(vertex_count=len(mesh.vertices_m), triangles=mesh.triangles, label=label) for mesh, label in solids),
            *(
                Body(vertex_count=len(gel.rest_position_m), triangles=gel.surface_triangles, label=label)
                for label in (Label.LEFT_GEL, Label.RIGHT_GEL)
            ),
        ]

    def _ipc_steps(self, amount: float, speed_per_s: float) -> int:
        return ipc_steps(amount, speed_per_s=speed_per_s, time_step_s=self._settings.physics.time_step_s)

    def _open_pose(self, offset: FusionOffset) -> GripperPose:
        """Return the pose of the gripper around the peg at an offset before the grasp."""
        angle_rad = radians(offset.theta_deg)
        sine, cosine = sine_cosine(angle_rad)
        along_mm = self._settings.gripper_x_mm
        return GripperPose(
            x_m=(offset.x_mm + cosine * along_mm) * 1e-3,
            y_m=(offset.y_mm + self.target.y_mm + sine * along_mm) * 1e-3,
            z_m=(_lower_end_mm(offset) + PEG_HEIGHT_MM + self._settings.gripper_z_mm) * 1e-3,
            angle_rad=angle_rad,
            half_opening_m=_open_half_m(),
        )


def _lower_end_mm(offset: FusionOffset) -> float:
    """Return the commanded height of the peg's lower end in the world [mm]."""
    return offset.z_mm + Z_TARGET_MM + START_GAP_MM


def _open_half_m() -> float:
    """Return the distance of the gels' centres from the gripper's before the grasp [m]."""
    return (GRIPPED_WIDTH_MM / 2.0 + GEL_HALF_THICKNESS_MM + GRASP_GAP_MM) * 1e-3
