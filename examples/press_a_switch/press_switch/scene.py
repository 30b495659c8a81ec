"""A finger between two gels above a switch: a housing, and a button on it that does not move."""

from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray
from vitac.envs.assets import Meshes
from vitac.envs.fem.model.mesh import RigidBody, SurfaceMesh
from vitac.envs.geometry.solid import prism_faces, rectangle, solid_from_faces
from vitac.envs.scene.grasped_scene import Clocks, GraspedScene, PhysicsSettings, fixed_at_origin
from vitac.envs.scene.gripper import UPRIGHT_MOUNTS, Gripper, GripperPose, SensorMount, ipc_steps
from vitac.envs.tactile.gel import highest_mm
from vitac.envs.tactile.markers import MarkerSettings

from .definition import TASK

FloatArray = NDArray[np.float64]

HOUSING_MM = 5.0
FINGER_MM = 30.0
FINGER_HEIGHT_MM = 40.0
START_MM = 6.0
GAP_MM = 0.1
SPEED_M_S = 5e-3
BUTTON_BODY = 4  # after both gels, the finger and the housing


class Button(StrEnum):
    """Shapes of the button."""

    SMALL = "small"
    LARGE = "large"


WIDTH_MM = {Button.SMALL: 6.0, Button.LARGE: 12.0}


@dataclass(frozen=True, kw_only=True)
class SwitchSettings:
    """What the task leaves open: keyword arguments of `gymnasium.make`."""

    max_steps: int = 24
    indentation_mm: float = 0.875
    action_scale_mm: tuple[float, ...] = TASK.action_scale
    physics: PhysicsSettings = field(default_factory=PhysicsSettings)
    markers: MarkerSettings = field(default_factory=MarkerSettings)


@dataclass(frozen=True, kw_only=True)
class SwitchStart:
    """Start of an episode: which button it is, and how high above the housing."""

    shape: Button
    height_mm: float


def finger_mesh() -> SurfaceMesh:
    """Return the finger, its lower face at z = 0."""
    half = 0.5 * FINGER_MM
    return solid_from_faces(prism_faces(rectangle(-half, half, -half, half), 0.0, FINGER_HEIGHT_MM), "finger")


def housing_mesh() -> SurfaceMesh:
    """Return the housing, its upper face at z = 5 mm."""
    return solid_from_faces(prism_faces(rectangle(-40.0, 40.0, -30.0, 30.0), 0.0, HOUSING_MM), "housing")


def button_mesh(shape: Button, height_mm: float) -> SurfaceMesh:
    """Return the button, which ends `height_mm` above the housing."""
    half, low = 0.5 * WIDTH_MM[shape], HOUSING_MM + GAP_MM
    faces = prism_faces(rectangle(-half, half, -half, half), low, HOUSING_MM + height_mm)
    return solid_from_faces(faces, f"{shape} button")


class SwitchScene:
    """The parts, and the motions of the gripper that the task knows."""

    mounts: tuple[SensorMount, SensorMount] = UPRIGHT_MOUNTS

    def __init__(self, *, start: SwitchStart, meshes: Meshes, settings: SwitchSettings, clocks: Clocks) -> None:
        self.env_steps = 0
        self.shape = start.shape  # demonstrations name it
        self._height_mm, self._settings = start.height_mm, settings
        finger = finger_mesh()
        self._bottom = np.flatnonzero(finger.vertices_m[:, 2] == 0.0)
        lowest_mm = HOUSING_MM + START_MM
        pose = GripperPose(
            x_m=0.0,
            y_m=0.0,
            z_m=(lowest_mm + 25.0) * 1e-3,
            angle_rad=0.0,
            half_opening_m=(0.5 * FINGER_MM + highest_mm(meshes.gel()) + GAP_MM) * 1e-3,
        )
        self._start_z_m = pose.z_m
        self.grasped = GraspedScene(
            gripper=Gripper(mounts=self.mounts, gel=meshes.gel(), pose=pose),
            held=RigidBody(
                mesh=finger,
                rotation=np.eye(3),
                translation_m=np.array([0.0, 0.0, lowest_mm]) * 1e-3,
                density_kg_m3=settings.physics.rigid_density_kg_m3,
                friction=9.5,
            ),
            fixed=fixed_at_origin(housing_mesh(), friction=0.5),
            others=(fixed_at_origin(button_mesh(start.shape, start.height_mm), friction=0.5),),
            physics=settings.physics,
            sensors=meshes.sensors(settings.markers),
            clocks=clocks,
        )

    def grasp(self) -> None:
        """Close on the finger, and take what the sensors then see as their undisturbed view."""
        closing_m = (GAP_MM + self._settings.indentation_mm) * 1e-3
        self._go(self.grasped.pose.moved(closing_m=closing_m), closing_m)
        self.grasped.capture_references()

    def move(self, command: FloatArray) -> None:
        """Move down as an action says."""
        down_m = float(np.clip(command[0], -1.0, 1.0)) * self._settings.action_scale_mm[0] * 1e-3
        self._go(self.grasped.pose.moved(z_m=-down_m), down_m)

    def gap_mm(self) -> FloatArray:
        """Return how high the finger's lower corners are above the button [mm], shape [4]."""
        heights_mm = self.grasped.held_vertices_m(self._bottom)[:, 2] * 1e3
        return np.asarray(heights_mm - HOUSING_MM - self._height_mm)

    def button_force_n(self) -> float:
        """Return the upward force of the button on the finger, measured from the contacts [N]."""
        return float(self.grasped.force_on_held_n(BUTTON_BODY)[2])

    def travel_mm(self) -> FloatArray:
        """Return the commanded way down [mm], shape [1]."""
        return np.array([self._start_z_m - self.grasped.pose.z_m]) * 1e3

    def height_mm(self) -> FloatArray:
        """Return the height of the button above the housing [mm], shape [1]."""
        return np.array([self._height_mm])

    def _go(self, goal: GripperPose, distance_m: float) -> None:
        time_step_s = self._settings.physics.time_step_s
        self.grasped.move_to(goal, ipc_steps=ipc_steps(distance_m, speed_per_s=SPEED_M_S, time_step_s=time_step_s))
