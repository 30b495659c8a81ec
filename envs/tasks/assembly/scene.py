"""Scene of the assembly: a part that stands in a tray, a socket beside it, and a gripper that is commanded in all."""

from dataclasses import dataclass, field, replace
from enum import StrEnum
from math import degrees, isfinite, radians

import numpy as np

from ...assets import Meshes
from ...deterministic_math import arctangent_deg, sine_cosine
from ...fem.model.mesh import PointMass, RigidBody, SurfaceMesh
from ...fem.model.settings import SolverSettings
from ...geometry.bayonet import (
    HEAD_HIGH_MM,
    HEAD_LOW_MM,
    LIP_MM,
    LUG_HEIGHT_MM,
    SHAFT_APOTHEM_MM,
    SOCKET_X_MM,
    TRAY_DEPTH_MM,
    bayonet_part,
    footprint_mm,
    opening_mm,
    tray_and_socket,
)
from ...geometry.solid import contains, nearest_vertices
from ...scene.grasped_scene import Clocks, GraspedScene, PhysicsSettings, fixed_at_origin
from ...scene.gripper import UPRIGHT_MOUNTS, Gripper, GripperPose
from ...scene.perspective import FloatArray
from ...tactile.gel import highest_mm
from ...tactile.markers import MarkerSettings
from ..settings import arena_physics, require
from .definition import TASK, AssemblyStage

GRAVITY_M_S2 = 9.81
START_WIDTH_MM = 36.0
# Free space below the part when the scene is built, and IPC steps in which it comes to rest.
_START_GAP_MM, _REST_STEPS = 0.1, 2
# The gripper is at the height of the middle of the head of the part in the tray.
_START_Z_MM = 0.5 * (HEAD_LOW_MM + HEAD_HIGH_MM) - TRAY_DEPTH_MM
# The gripper goes no lower, 2 mm beyond its range: the gels' lower edges are 0.4 mm above the plate there.
_LOWEST_Z_MM = _START_Z_MM - 10.0

# Share of the part's mass that is spread over it; the rest is a weight between the lugs, so that it stands up again.
_SPREAD = 0.2

ALIGNED_BELOW_MM = 2.0
INSERTED_BELOW_MM = -(LIP_MM + LUG_HEIGHT_MM)
LOCKED_DEG = 57.0
FETCHED_ABOVE_MM = 0.3


class HeadShape(StrEnum):
    """Parts by the width of their heads along x."""

    NARROW = "narrow"
    """10 mm."""
    WIDE = "wide"
    """14 mm, nearly as much as a sensing face."""


_HEAD_WIDTH_MM = {HeadShape.NARROW: 10.0, HeadShape.WIDE: 14.0}


def part_mesh(shape: HeadShape) -> SurfaceMesh:
    """Return the part of this shape."""
    return bayonet_part(_HEAD_WIDTH_MM[shape])


def assembly_physics() -> PhysicsSettings:
    """Return the contact model arena-2 with its gel, gravity, and IPC steps of 0.2 s.

    A turn of the gripper takes more Newton iterations than a translation, so that more of them are free.
    """
    solver = SolverSettings(phase_iterations=20)
    return replace(arena_physics(), time_step_s=0.2, gravity_m_s2=GRAVITY_M_S2, solver=solver)


@dataclass(frozen=True, kw_only=True)
class AssemblySettings:
    """What the task leaves open.

    Attributes:
        max_steps: env steps after which an episode is cut off.
        ipc_steps: of an env step.
        action_scale_mm_deg: motion at an action of 1: x, y, z [mm], theta [deg], width [mm].
        part_mass_kg: mass of the part.
        stage_reward: of a stage, in parts as it comes nearer.
        step_penalty: of an env step in the reward.
        failure_penalty: of the flags that end an episode.
        random_x_mm: largest |x| of a random start.
        random_y_mm: largest |y| of a random start.
        random_theta_deg: largest angle of a random start, either way.
        physics: materials and time stepping.
        markers: ranges of the marker grid.
    """

    max_steps: int = 40
    ipc_steps: int = 1
    action_scale_mm_deg: tuple[float, ...] = TASK.action_scale
    part_mass_kg: float = 0.08
    stage_reward: float = 10.0
    step_penalty: float = 0.1
    failure_penalty: float = 5.0
    random_x_mm: float = 4.5
    random_y_mm: float = 1.0
    random_theta_deg: float = 10.0
    physics: PhysicsSettings = field(default_factory=assembly_physics)
    markers: MarkerSettings = field(default_factory=MarkerSettings)

    def __post_init__(self) -> None:
        require(self.max_steps >= 1, "max_steps", self.max_steps, "at least 1")
        require(1 <= self.ipc_steps <= 100, "ipc_steps", self.ipc_steps, "1 to 100")
        scale = self.action_scale_mm_deg
        usable = len(scale) == len(TASK.actions) and all(isfinite(value) and 0 <= value <= 10 for value in scale)
        require(usable, "action_scale_mm_deg", scale, "five numbers of 0 to 10")
        require(0.01 <= self.part_mass_kg <= 1, "part_mass_kg", self.part_mass_kg, "0.01 to 1 kg")
        for name, largest in (("random_x_mm", 4.5), ("random_y_mm", 1.0), ("random_theta_deg", 10.0)):
            require(0 <= getattr(self, name) <= largest, name, getattr(self, name), f"0 to {largest:g}")


@dataclass(frozen=True, kw_only=True)
class AssemblyStart:
    """Start of an episode.

    Attributes:
        shape: of the part.
        x_mm: where it is in the tray, from the middle.
        y_mm: the same along y.
        theta_deg: by how much it is turned.
    """

    shape: HeadShape
    x_mm: float
    y_mm: float
    theta_deg: float


class AssemblyScene:
    """A part that stands in a tray, and the motions of the gripper around it.

    Attributes:
        grasped: the physics, the gripper and its sensors.
        env_steps: played so far in the episode.
        shape: of the part.
        stage: the furthest that was reached so far.
    """

    def __init__(self, *, start: AssemblyStart, meshes: Meshes, settings: AssemblySettings, clocks: Clocks) -> None:
        self.shape, self.env_steps, self.stage = start.shape, 0, AssemblyStage.NOTHING
        self._settings = settings
        part, foot = part_mesh(start.shape), footprint_mm()
        corners_m = np.column_stack([foot, np.zeros(len(foot))]) * 1e-3
        self.measured_vertices = nearest_vertices(part, corners_m)
        sine, cosine = sine_cosine(radians(start.theta_deg))
        self._start_pose = GripperPose(
            x_m=0.0,
            y_m=0.0,
            z_m=1e-3 * _START_Z_MM,
            angle_rad=0.0,
            half_opening_m=1e-3 * (0.5 * START_WIDTH_MM + highest_mm(meshes.gel())),
        )
        self.grasped = GraspedScene(
            gripper=Gripper(mounts=UPRIGHT_MOUNTS, gel=meshes.gel(), pose=self._start_pose),
            held=RigidBody(
                mesh=part,
                rotation=np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]]),
                translation_m=1e-3 * np.array([start.x_mm, start.y_mm, _START_GAP_MM - TRAY_DEPTH_MM]),
                density_kg_m3=_SPREAD * settings.part_mass_kg / part.volume_m3,
                point_masses=(PointMass((1.0 - _SPREAD) * settings.part_mass_kg, np.array([0.0, 0.0, 2e-3])),),
            ),
            fixed=fixed_at_origin(tray_and_socket(), friction=0.5),
            physics=settings.physics,
            sensors=meshes.sensors(settings.markers),
            clocks=clocks,
        )

    def grasp(self) -> None:
        """Let the part come to rest in the tray, and take the references; the gripper is open."""
        self.grasped.move_to(self._start_pose, ipc_steps=_REST_STEPS)
        self.grasped.capture_references()

    def move(self, command: FloatArray) -> None:
        """Move, turn and close the gripper as an action says, all together, and note which stage that reaches.

        It stops above the plate.
        """
        scaled = np.clip(command, -1.0, 1.0) * np.array(self._settings.action_scale_mm_deg)
        x_mm, y_mm, z_mm, theta_deg, wider_mm = scaled.tolist()
        goal = self.grasped.pose.moved(
            x_m=1e-3 * x_mm,
            y_m=1e-3 * y_mm,
            z_m=max(1e-3 * z_mm, 1e-3 * _LOWEST_Z_MM - self.grasped.pose.z_m),
            angle_rad=radians(theta_deg),
            closing_m=-0.5e-3 * wider_mm,
        )
        self.grasped.move_to(goal, ipc_steps=self._settings.ipc_steps)
        self.stage = max(self.stage, self._present_stage())

    def relative_motion_mm_deg(self) -> FloatArray:
        """Return the commanded motion since the start, x, y, z and theta [mm, mm, mm, deg], shape [4]."""
        now, first = self.grasped.pose, self._start_pose
        motion_m = [now.x_m - first.x_m, now.y_m - first.y_m, now.z_m - first.z_m]
        return np.array([*(1e3 * value for value in motion_m), degrees(now.angle_rad - first.angle_rad)])

    def offset_mm_deg(self) -> FloatArray:
        """Return where the part is from the socket: the middle of its lower end, and its turn, shape [4]."""
        corners_mm = self._corners_mm()
        x, y, z = (sum(corners_mm[:, axis].tolist()) / len(corners_mm) for axis in range(3))
        # Lower corners of the lug towards +y, then of the other one.
        first, second = corners_mm[3:5], corners_mm[9:11]
        across, along = (float(first[0, axis] + first[1, axis] - second[0, axis] - second[1, axis]) for axis in (0, 1))
        return np.array([x - SOCKET_X_MM, y, z, arctangent_deg(-across, along)])

    def heights_mm(self) -> FloatArray:
        """Return the heights of the part's lower corners above the plate [mm], shape [12]."""
        return self._corners_mm()[:, 2]

    def _corners_mm(self) -> FloatArray:
        return 1e3 * self.grasped.held_vertices_m(self.measured_vertices)

    def _present_stage(self) -> AssemblyStage:
        """Return the furthest stage of which what it asks for holds now."""
        corners_mm = self._corners_mm()
        highest_mm, lowest_mm = float(corners_mm[:, 2].max()), float(corners_mm[:, 2].min())
        x_mm, y_mm, _, turn_deg = self.offset_mm_deg().tolist()
        opening = np.array([SOCKET_X_MM, 0.0]) + opening_mm()
        # What fell off the plate is low, too.
        if highest_mm < INSERTED_BELOW_MM and max(abs(x_mm), abs(y_mm)) < SHAFT_APOTHEM_MM:
            return AssemblyStage.LOCKED if turn_deg >= LOCKED_DEG else AssemblyStage.INSERTED
        if highest_mm < ALIGNED_BELOW_MM and all(contains(opening, corner) for corner in corners_mm[:, :2]):
            return AssemblyStage.ALIGNED
        return AssemblyStage.FETCHED if lowest_mm > FETCHED_ABOVE_MM else AssemblyStage.NOTHING
