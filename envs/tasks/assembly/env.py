"""`ViTac/Assembly-v1`: fetch a part from a tray, put it into a socket and turn it until it locks.

First its scene: the part in its tray, the socket beside it, and a gripper that is commanded in all directions.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum
from math import degrees, isfinite, radians
from typing import Any, ClassVar

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
    TURN_DEG,
    bayonet_part,
    footprint_mm,
    opening_mm,
    tray_and_socket,
)
from ...geometry.solid import contains, nearest_vertices
from ...scene.grasped_scene import Clocks, GraspedScene, PhysicsSettings, fixed_at_origin
from ...scene.gripper import UPRIGHT_MOUNTS, Gripper, GripperPose
from ...scene.perspective import ActionArray, FloatArray
from ...tactile.gel import highest_mm
from ...tactile.markers import MarkerSettings
from ..definition import Flags, surface_moved_too_far
from ..settings import SHAPE, arena_physics, choose_shape, either_way, numbers, require
from ..task_env import Info, Observation, TactileTaskEnv
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


OFFSET = "offset_mm_deg"
LARGEST_MM_DEG = (4.5, 1.0, 10.0)
# Lowest and highest commanded motion since the start: x, y, z [mm], theta [deg].
RANGE_MM_DEG = ((-12.0, 38.0), (-8.0, 8.0), (-8.0, 16.0), (-40.0, 90.0))
LARGEST_TILT_MM = 5.0
"""By how much a lower corner of the part may be higher than another one: it then tilts by 15 degrees."""
LOWEST_MM = -12.0
_ROUNDING_MM = 1e-5


class AssemblyEnv(TactileTaskEnv[AssemblyScene, AssemblySettings]):
    """Fetch a part from a tray, put its lugs through the opening of a socket, and turn them below its lip, by touch.

    The part stands in a tray of 20 x 22 mm, up to 4.5 mm beside its middle and turned by up to 10 degrees, and the open
    gripper is over the middle. Closed on it the gripper centres it along y only: where it is held along x, and turned,
    is in the markers. The opening of the socket has 0.7 mm of clearance on all sides, 3 mm below it the lugs can turn
    towards positive theta, and after 60 degrees they meet stops. Actions move the gripper in the world, turn it about
    its own middle and change its width. Actions outside -1 to 1 are clipped. World frame: z up, the plate's top at
    z = 0, the tray's middle at x = y = 0, its floor 3 mm deep, and the socket's middle at x = 26 mm.

    Stages, of which the furthest one reached is scored: fetched (1): all of the part's lower end was more than 0.3 mm
    above the plate; aligned (2): all of it was over the opening or in it, lower than 2 mm above the plate; inserted
    (3): it was lower than 7 mm below the plate, which has the lugs below the lip; locked (4): the lugs were turned
    there by at least 57 degrees. An env step takes 0.2 s.

    The grid of `marker_flow` is drawn again at every observation. Contacts are those of `arena-2`.

    Reset options: `shape` ("narrow", "wide": the part's head), `offset_mm_deg` (x, y, theta of the part in the tray),
    and `rng_seed`, the integers that seed the episode's generator in place of the environment's own. What is left open
    is drawn: the shape, x within 4.5 mm, y within 1 mm, and theta within 10 degrees.

    Ends: terminated by success, the fourth stage (`end_reason` "success"); truncated by a sensing surface that moved
    more than 1.5 mm ("tactile"); by a gripper that left its range of -12 to 38 mm along x, 8 mm either way along y, -8
    to 16 mm upwards (it stops above the plate, at -10 mm) and -40 to 90 degrees from the start, or a part that fell
    over, tilted by more than 15 degrees, or fell off ("error"); by 40 env steps ("steps"), or physics that did not
    converge ("not_converged", after which nothing moves).

    Keyword arguments: those of `TactileTaskEnv`, and fields of `AssemblySettings`.
    """

    task: ClassVar = TASK
    settings_type: ClassVar = AssemblySettings
    scene_type: ClassVar = AssemblyScene
    shape_type: ClassVar = HeadShape
    option_names: ClassVar[tuple[str, ...]] = (SHAPE, OFFSET)

    def _solids(self) -> list[SurfaceMesh]:
        return [*map(part_mesh, HeadShape), tray_and_socket()]

    def choose_start(
        self, options: Mapping[str, Any], random: np.random.Generator, settings: AssemblySettings
    ) -> AssemblyStart:
        """Return the start that the options give; what they leave open is drawn: shape, then x, y and theta."""
        shape, wanted = choose_shape(self.env_id, options, self._shapes, random), options.get(OFFSET)
        if wanted is None:
            x, y, theta = random.uniform(-1.0, 1.0, 3).tolist()
            return AssemblyStart(
                shape=shape,
                x_mm=x * settings.random_x_mm,
                y_mm=y * settings.random_y_mm,
                theta_deg=theta * settings.random_theta_deg,
            )
        expected = (
            f"expected (x mm, y mm, theta deg) within {', '.join(f'{value:g}' for value in LARGEST_MM_DEG)} either way"
        )
        x_mm, y_mm, theta_deg = numbers(self.env_id, OFFSET, wanted, either_way(*LARGEST_MM_DEG), expected)
        return AssemblyStart(shape=shape, x_mm=x_mm, y_mm=y_mm, theta_deg=theta_deg)

    def _error(self) -> float:
        """Return the stages that are left, the next one in parts."""
        stage, (x, y, z, theta) = self.task_scene.stage, self.task_scene.offset_mm_deg().tolist()
        left = (
            (FETCHED_ABOVE_MM - z) / 3.0,
            (abs(x) + abs(y) + abs(theta) + max(0.0, z)) / 40.0,
            (z - INSERTED_BELOW_MM) / 10.0,
            (TURN_DEG - theta) / TURN_DEG,
            0.0,
        )
        return max(0, AssemblyStage.LOCKED - stage - 1) + min(1.0, max(0.0, left[stage]))

    def _judge(self) -> Flags:
        scene = self.task_scene
        tactile = surface_moved_too_far(scene.grasped.surface_diff_m())
        heights_mm = scene.heights_mm()
        lost = float(heights_mm.max() - heights_mm.min()) > LARGEST_TILT_MM or float(heights_mm.min()) < LOWEST_MM
        error = lost or self._left_range(scene.relative_motion_mm_deg())
        return Flags(
            tactile_movement_too_large=tactile,
            error_too_large=error,
            too_many_steps=scene.env_steps >= self.settings.max_steps,
            is_success=scene.stage is AssemblyStage.LOCKED and not (tactile or error),
        )

    def _left_range(self, motion: FloatArray) -> bool:
        pairs = zip(motion.tolist(), RANGE_MM_DEG, strict=True)
        return any(not low - _ROUNDING_MM <= value <= high + _ROUNDING_MM for value, (low, high) in pairs)

    def _reward(self, flags: Flags, progress: float) -> float:
        settings = self.settings
        reward = settings.stage_reward * progress - settings.step_penalty
        return reward - (settings.failure_penalty if flags.has_failed else 0.0)

    def _info(self, flags: Flags) -> Info:
        scene = self.task_scene
        return {
            **self._common_info(flags),
            "stage": int(scene.stage),
            "offset_mm_deg": scene.offset_mm_deg(),
            "relative_motion_mm_deg": scene.relative_motion_mm_deg(),
            "gripper_width_mm": 1e3 * scene.grasped.gripper_width_m,
            "grip_force_n": scene.grasped.grip_force_n(),
            "is_success": flags.is_success,
        }


# Heights of the part's lower end that the expert goes for, above the plate; it is in the opening below the third one.
_CARRIED_MM, _INSERTED_MM, _IN_MM = 1.2, -7.8, -0.5
# How far beside the opening the part already goes down, to slide over the rim pressed on it.
_NEARBY_MM, _RIM_MM = 2.5, -0.1
# Width at which the gels do not touch the head yet, the grip force, and the force of a jaw by how far it closes on.
_NEAR_MM, _GRIP_N, _STIFFNESS_N_MM = 30.8, 20.0, 45.0


def fetch_insert_and_turn(_: Observation, info: Info) -> ActionArray:
    """Close on the part, carry it straight over the socket, put it in and turn it against the stops.

    It is gripped where it is, and where it comes to the socket beside the opening it goes down and slides over the rim:
    who imitates this feels how it is held, and that it is not over the opening yet.
    """
    x_mm, y_mm, z_mm, theta_deg = info["offset_mm_deg"].tolist()
    gone = info["relative_motion_mm_deg"].tolist()
    arm_mm = (gone[0] - x_mm - SOCKET_X_MM, gone[1] - y_mm)
    closing_mm = (_GRIP_N - info["grip_force_n"]) / _STIFFNESS_N_MM
    if info["stage"] == AssemblyStage.NOTHING and info["grip_force_n"] < 0.6 * _GRIP_N:
        to_near_mm = info["gripper_width_mm"] - _NEAR_MM
        return _scaled([0.0, 0.0, 0.0, 0.0, -(to_near_mm if to_near_mm > 1e-3 else closing_mm)])
    aside_mm, turned_deg = max(abs(x_mm), abs(y_mm)), abs(theta_deg)
    way = [-x_mm, -y_mm, _CARRIED_MM - z_mm, -theta_deg]
    if aside_mm < _NEARBY_MM and z_mm < INSERTED_BELOW_MM - 0.3:
        way[2:] = [_INSERTED_MM - z_mm, TURN_DEG - theta_deg]
    elif (aside_mm < _NEARBY_MM and z_mm < _IN_MM) or (aside_mm < 0.5 and turned_deg < 3.0):
        way[2] = _INSERTED_MM - z_mm
    elif aside_mm < _NEARBY_MM and turned_deg < 10.0:
        way[2] = _RIM_MM - z_mm
    elif z_mm < FETCHED_ABOVE_MM:
        way[:2] = [0.0, 0.0]
    part = _longest(way)
    # The gripper turns about its own middle, which is an arm away from the part's.
    sine, cosine = sine_cosine(radians(part[3]))
    part[0] += cosine * arm_mm[0] - sine * arm_mm[1] - arm_mm[0]
    part[1] += sine * arm_mm[0] + cosine * arm_mm[1] - arm_mm[1]
    return _scaled([*part, -closing_mm])


def _longest(way: list[float]) -> list[float]:
    """Return the longest motion in an env step along a straight line that does not go beyond its end."""
    longest = max(1.0, *(abs(value) / scale for value, scale in zip(way, TASK.action_scale, strict=False)))
    return [value / longest for value in way]


def _scaled(motion: list[float]) -> ActionArray:
    return np.asarray(np.clip(np.array(motion) / np.array(TASK.action_scale), -1.0, 1.0), dtype=np.float32)
