"""A block on a table between two gels."""

from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray
from vitac.envs.assets import Meshes
from vitac.envs.fem.model.bodies import RigidBody
from vitac.envs.fem.model.mesh import SurfaceMesh
from vitac.envs.geometry.solid import prism_faces, rectangle, solid_from_faces
from vitac.envs.scene.grasped_scene import Clocks, GraspedScene, PhysicsSettings, fixed_at_origin
from vitac.envs.scene.gripper import Gripper, GripperPose, SensorMount
from vitac.envs.scene.motion import ipc_steps
from vitac.envs.tactile.markers import MarkerSettings
from vitac.envs.tactile.thickness import highest_mm

from .definition import TASK

FloatArray = NDArray[np.float64]

TABLE_MM = 5.0
WIDTH_MM = 30.0
GAP_MM = 0.1
SPEED_M_S = 5e-3
MOUNTS = (
    SensorMount(side=1, rotation=np.array([[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0]])),
    SensorMount(side=-1, rotation=np.array([[0.0, -1.0, 0.0], [0.0, 0.0, 1.0], [-1.0, 0.0, 0.0]])),
)


class Block(StrEnum):
    LOW = "low"
    HIGH = "high"


HEIGHT_MM = {Block.LOW: 40.0, Block.HIGH: 50.0}


@dataclass(frozen=True, kw_only=True)
class LiftSettings:
    max_steps: int = 4
    indentation_mm: float = 0.875
    action_scale_mm: tuple[float, ...] = TASK.action_scale
    physics: PhysicsSettings = field(default_factory=PhysicsSettings)
    markers: MarkerSettings = field(default_factory=MarkerSettings)


def block_mesh(shape: Block) -> SurfaceMesh:
    half = 0.5 * WIDTH_MM
    return solid_from_faces(prism_faces(rectangle(-half, half, -half, half), 0.0, HEIGHT_MM[shape]), f"{shape} block")


def table_mesh() -> SurfaceMesh:
    return solid_from_faces(prism_faces(rectangle(-40.0, 40.0, -30.0, 30.0), 0.0, TABLE_MM), "table")


class LiftScene:
    def __init__(self, shape: Block, x_mm: float, *, meshes: Meshes, settings: LiftSettings, clocks: Clocks) -> None:
        self.env_steps = 0
        self._x_mm, self._settings = x_mm, settings
        block = block_mesh(shape)
        self._bottom = np.flatnonzero(block.vertices_m[:, 2] == 0.0)
        pose = GripperPose(
            x_m=x_mm * 1e-3,
            y_m=0.0,
            z_m=(TABLE_MM + 25.0) * 1e-3,
            angle_rad=0.0,
            half_opening_m=(0.5 * WIDTH_MM + highest_mm(meshes.gel()) + GAP_MM) * 1e-3,
        )
        self.grasped = GraspedScene(
            gripper=Gripper(mounts=MOUNTS, gel=meshes.gel(), pose=pose),
            held=RigidBody(
                mesh=block,
                rotation=np.eye(3),
                translation_m=np.array([x_mm, 0.0, TABLE_MM + GAP_MM]) * 1e-3,
                density_kg_m3=settings.physics.rigid_density_kg_m3,
                friction=9.5,
            ),
            fixed=fixed_at_origin(table_mesh(), friction=0.5),
            physics=settings.physics,
            sensors=meshes.sensors(settings.markers),
            clocks=clocks,
        )

    def grasp(self) -> None:
        closing_m = (GAP_MM + self._settings.indentation_mm) * 1e-3
        self._go(self.grasped.pose.moved(closing_m=closing_m), closing_m)
        self.grasped.capture_references()

    def move(self, command: FloatArray) -> None:
        up_m = float(np.clip(command[0], -1.0, 1.0)) * self._settings.action_scale_mm[0] * 1e-3
        self._go(self.grasped.pose.moved(z_m=up_m), up_m)

    def heights_mm(self) -> FloatArray:
        return self.grasped.held_vertices_m(self._bottom)[:, 2] * 1e3 - TABLE_MM

    def place_mm(self) -> FloatArray:
        return np.array([self._x_mm])

    def _go(self, goal: GripperPose, distance_m: float) -> None:
        time_step_s = self._settings.physics.time_step_s
        self.grasped.move_to(goal, ipc_steps=ipc_steps(distance_m, speed_per_s=SPEED_M_S, time_step_s=time_step_s))
