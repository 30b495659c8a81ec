"""What the environments share that insert a peg: reward, info, goals like Gymnasium-Robotics', the way to the hole.

First their scene: a peg between two upright gels above its hole, its offset and motions, and what judges an env step.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import isfinite, radians
from typing import Any, Generic, TypedDict, TypeVar

import gymnasium
import numpy as np
from gymnasium.spaces.utils import flatten, flatten_space
from numpy.typing import NDArray
from vitac.errors import VitacError

from ...deterministic_math import sine_cosine
from ...fem.model.mesh import GelMesh, RigidBody, SurfaceMesh
from ...geometry.pegs import GRIPPED_WIDTH_MM, PEG_HEIGHT_MM
from ...scene.grasped_scene import Clocks, GraspedScene, PhysicsSettings, fixed_at_origin
from ...scene.gripper import UPRIGHT_MOUNTS, Gripper, GripperPose, ipc_steps
from ...tactile.gel import highest_mm
from ...tactile.markers import MarkerSettings
from ...tactile.sensor import TactileSensor
from ..definition import Flags, surface_moved_too_far
from ..quantities import Ranges, check_quantities
from ..settings import require
from ..task_env import Info, TactileTaskEnv
from .interface import GRIPPER_X, GRIPPER_Z, TILTS, PegOffset, norm

OffsetT = TypeVar("OffsetT", bound=PegOffset)


@dataclass(frozen=True, kw_only=True)
class InsertionState(Generic[OffsetT]):
    """What an env step is judged by.

    Attributes:
        env_steps: played so far, this one included.
        offset: commanded offset from the hole.
        surface_diff_m: of the left and the right sensor [m], shape [2].
        peg_relative_z_mm: height of each bottom corner of the peg above the rim, measured [mm], shape [n].
    """

    env_steps: int
    offset: OffsetT
    surface_diff_m: NDArray[np.float64]
    peg_relative_z_mm: NDArray[np.float64]

    def is_deeper_than(self, depth_mm: float) -> bool:
        """Return whether all of the peg's lower end is further below the rim than this [mm]."""
        return bool((self.peg_relative_z_mm < -depth_mm).all())


def compute_flags(state: InsertionState[OffsetT], *, max_steps: int, left_range: bool, reached: bool) -> Flags:
    """Return the flags of an env step; the goal counts as reached only where no other flag is raised.

    A large surface motion is such a flag rather than a threshold of its own.
    """
    tactile = surface_moved_too_far(state.surface_diff_m)
    steps = state.env_steps >= max_steps
    return Flags(
        tactile_movement_too_large=tactile,
        too_many_steps=steps,
        error_too_large=left_range,
        is_success=reached and not (tactile or steps or left_range),
    )


_WORDS = {3: "three", 4: "four"}


@dataclass(frozen=True, kw_only=True)
class InsertionSettings:
    """What every task that inserts a peg leaves open; lengths in mm and angles in degrees are the challenge's own.

    Attributes:
        max_steps: env steps after which an episode is cut off.
        action_scale_mm_deg: motion at an action of 1: x [mm], y [mm], theta [deg], and z [mm] where the action has it.
        step_penalty: P in the reward.
        final_reward: reward of success.
        indentation_mm: how far each gel is pressed into the peg.
        gripper_x_mm: grasp centre along the peg's x axis.
        gripper_z_mm: grasp centre above the peg's upper end.
        peg_tilt_deg: of the peg about the axis along which the gels close; about the other one they press it upright.
        hole_tilt_x_deg: of the part with the hole about the world's x axis.
        hole_tilt_y_deg: of the part with the hole about the world's y axis, after that about x.
        peg_friction: friction coefficient of the peg.
        random_xy_mm: largest |x| and |y| of a random start.
        random_theta_deg: largest |theta| of a random start.
        physics: materials of the gels and time stepping.
        markers: ranges of the marker grid.
    """

    max_steps: int
    action_scale_mm_deg: tuple[float, ...]
    step_penalty: float
    final_reward: float
    indentation_mm: float = 0.875
    gripper_x_mm: float = GRIPPER_X.nominal
    gripper_z_mm: float = GRIPPER_Z.nominal
    peg_tilt_deg: float = 0.0
    hole_tilt_x_deg: float = 0.0
    hole_tilt_y_deg: float = 0.0
    peg_friction: float = 9.5
    random_xy_mm: float = 5.0
    random_theta_deg: float = 10.0
    physics: PhysicsSettings = field(default_factory=PhysicsSettings)
    markers: MarkerSettings = field(default_factory=MarkerSettings)


def training_ranges(fixed_friction: str) -> Ranges:
    """Return the ranges of the published training.

    Args:
        fixed_friction: the setting with the friction coefficient of the part with the hole.
    """
    return {
        "physics.gel_friction": (50.0, 125.0),
        "peg_friction": (4.0, 15.0),
        fixed_friction: (0.0, 1.0),
        "indentation_mm": (0.5, 1.25),
        "gripper_x_mm": (-1.0, 1.0),
        "gripper_z_mm": (-10.0, -6.0),
    }


def check_settings(settings: InsertionSettings, *, action_numbers: int) -> None:
    """Refuse settings that no insertion task can be played with.

    Raises:
        SettingsError: one is out of range.
    """
    require(settings.max_steps >= 1, "max_steps", settings.max_steps, "at least 1")
    scale = settings.action_scale_mm_deg
    usable = len(scale) == action_numbers and all(isfinite(value) and 0 <= value <= 20 for value in scale)
    require(usable, "action_scale_mm_deg", scale, f"{_WORDS[action_numbers]} numbers of 0 to 20")
    indentation_mm = settings.indentation_mm
    require(0 < indentation_mm <= 2, "indentation_mm", indentation_mm, "0 to 2 mm, half the gel")
    check_quantities(settings, (GRIPPER_X, *TILTS))
    require(-17 <= settings.gripper_z_mm <= 0, "gripper_z_mm", settings.gripper_z_mm, "-17 to 0 mm")
    check_friction("peg_friction", settings.peg_friction)


def check_friction(name: str, value: float) -> None:
    """Refuse a friction coefficient that is out of range.

    Raises:
        SettingsError: it is.
    """
    require(0 <= value <= 1e3, name, value, "0 to 1000")


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

    def _travel(self, goal: OffsetT, *, ipc_steps: int, raised_mm: float = 0.0) -> None:
        """Drive the grasped peg to an offset, all axes together.

        Args:
            goal: new commanded offset.
            ipc_steps: that it takes.
            raised_mm: height above that of the offset.
        """
        closing_m = self._open_half_m() - self.grasped.pose.half_opening_m
        self.offset = goal
        pose = self._open_pose(goal).moved(z_m=raised_mm * 1e-3, closing_m=closing_m)
        self.grasped.move_to(pose, ipc_steps=ipc_steps)

    def _steps_to(self, goal: OffsetT, distance_mm: float) -> int:
        """Return the IPC steps to an offset whose longest way along an axis is this [mm], at the task's speeds."""
        turn_rad = radians(goal.theta_deg - self.offset.theta_deg)
        return max(self._ipc_steps(distance_mm * 1e-3, TRAVEL_SPEED_M_S), self._ipc_steps(turn_rad, TURN_SPEED_RAD_S))

    def _ipc_steps(self, amount: float, speed_per_s: float) -> int:
        return ipc_steps(amount, speed_per_s=speed_per_s, time_step_s=self._settings.physics.time_step_s)

    def _place_fixed(self, mesh: SurfaceMesh, friction: float) -> RigidBody:
        """Return the part with the hole where it stands."""
        return fixed_at_origin(mesh, friction=friction)

    def _placed_peg(self) -> RigidBody:
        """Return the peg at the commanded offset."""
        return place_peg(self._parts.peg, self.offset, self._lower_end_mm(self.offset), self._settings)

    def _open_pose(self, offset: OffsetT) -> GripperPose:
        """Return the pose of the gripper around the peg at an offset before the grasp."""
        x_m, y_m, z_m = _grasp_m(offset, self._lower_end_mm(offset), self._settings)
        angle_rad = radians(offset.theta_deg)
        return GripperPose(x_m=x_m, y_m=y_m, z_m=z_m, angle_rad=angle_rad, half_opening_m=self._open_half_m())

    def _open_half_m(self) -> float:
        """Return the distance of the gels' origins from the gripper's before the grasp [m]."""
        return (0.5 * GRIPPED_WIDTH_MM + highest_mm(self._parts.gel) + GRASP_GAP_MM) * 1e-3


def place_peg(
    mesh: SurfaceMesh, offset: PegOffset, lower_end_mm: tuple[float, float, float], settings: InsertionSettings
) -> RigidBody:
    """Return a peg at an offset, tilted about the middle of the grasp.

    Args:
        mesh: of the peg.
        offset: whose angle it has.
        lower_end_mm: where the middle of its lower end would be if it were upright [mm].
        settings: with its tilt.
    """
    sine, cosine = sine_cosine(radians(offset.theta_deg))
    rotation = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    translation_m = np.array(lower_end_mm) * 1e-3
    if settings.peg_tilt_deg != 0.0:
        s, c = sine_cosine(radians(settings.peg_tilt_deg))
        rotation = np.array([[cosine * c, -sine, cosine * s], [sine * c, cosine, sine * s], [-s, 0.0, c]])
        grasp_of_peg_m = np.array((settings.gripper_x_mm, 0.0, PEG_HEIGHT_MM + settings.gripper_z_mm)) * 1e-3
        translation_m = np.array(_grasp_m(offset, lower_end_mm, settings)) - (rotation * grasp_of_peg_m).sum(axis=1)
    return RigidBody(
        mesh=mesh,
        rotation=rotation,
        translation_m=translation_m,
        density_kg_m3=settings.physics.rigid_density_kg_m3,
        friction=settings.peg_friction,
    )


def lay(part: RigidBody, settings: InsertionSettings) -> RigidBody:
    """Return the part with the hole, which stands at the origin, tilted about the middle of its upper face."""
    tilt_deg = settings.hole_tilt_x_deg, settings.hole_tilt_y_deg
    if tilt_deg == (0.0, 0.0):
        return part
    (sx, cx), (sy, cy) = (sine_cosine(radians(angle)) for angle in tilt_deg)
    rotation = np.array([[cy, sy * sx, sy * cx], [0.0, cx, -sx], [-sy, cy * sx, cy * cx]])
    top_m = np.array((0.0, 0.0, float(part.mesh.vertices_m[:, 2].max())))
    return replace(part, rotation=rotation, translation_m=top_m - rotation[:, 2] * top_m[2])


def _grasp_m(
    offset: PegOffset, lower_end_mm: tuple[float, float, float], settings: InsertionSettings
) -> tuple[float, float, float]:
    """Return the middle of the grasp of a peg whose lower end is there [m]."""
    sine, cosine = sine_cosine(radians(offset.theta_deg))
    along_mm = settings.gripper_x_mm
    x_mm, y_mm, z_mm = lower_end_mm
    return (
        (x_mm + cosine * along_mm) * 1e-3,
        (y_mm + sine * along_mm) * 1e-3,
        (z_mm + PEG_HEIGHT_MM + settings.gripper_z_mm) * 1e-3,
    )


class InsertionInfo(TypedDict):
    """The challenge's entries, in the order of its logs; the base adds how the episode ended.

    Attributes:
        steps: env steps played so far.
        surface_diff_m: mean motion of the left and the right sensing surface since the grasp [m], shape [2].
        tactile_movement_too_large: one of them is more than the task allows.
        too_many_steps: the env steps are used up.
        error_too_large: the commanded offset left its range.
        peg_relative_z_mm: height of each bottom corner of the peg above the rim, measured [mm], shape [n].
        is_success: the task is solved.
        relative_motion_mm_deg: commanded motion (x, y, theta, z) since the reset [mm, mm, deg, mm], shape [4].
        gt_offset_mm_deg: commanded offset from the hole (x, y, theta, and z where the action has it) [mm, mm, deg, mm].
    """

    steps: int
    surface_diff_m: NDArray[np.float64]
    tactile_movement_too_large: bool
    too_many_steps: bool
    error_too_large: bool
    peg_relative_z_mm: NDArray[np.float64]
    is_success: bool
    relative_motion_mm_deg: NDArray[np.float64]
    gt_offset_mm_deg: NDArray[np.float64]


def insertion_reward(flags: Flags, settings: InsertionSettings, *, progress: float, env_steps: int) -> float:
    """Return the reward of an env step: progress, less the penalty, plus what the end brings.

    The force, tactile or error flag costs 2 P for every step that is left, less one P, which the published formula does
    not have; running out of steps costs nothing more.

    Args:
        flags: of the env step.
        settings: of the task.
        progress: by how much the env step has brought the error e down.
        env_steps: played so far, this one included.
    """
    final = 0.0
    if flags.has_failed:
        final = -2.0 * settings.step_penalty * (settings.max_steps - env_steps) + settings.step_penalty
    elif flags.is_success:
        final = settings.final_reward
    return progress - settings.step_penalty + final


SceneT = TypeVar("SceneT", bound=InsertionScene[Any, Any])


class InsertionEnv(TactileTaskEnv[SceneT, SettingsT]):
    """What the insertion tasks are rewarded for and tell; a task adds its scene, its starts and its goal."""

    def _error(self) -> float:
        offset: PegOffset = self.task_scene.offset
        return offset.magnitude()

    def _reward(self, flags: Flags, progress: float) -> float:
        return insertion_reward(flags, self.settings, progress=progress, env_steps=self.task_scene.env_steps)

    def _info(self, flags: Flags) -> Info:
        scene = self.task_scene
        state = scene.state()
        info: InsertionInfo = {
            "steps": state.env_steps,
            "surface_diff_m": state.surface_diff_m,
            "tactile_movement_too_large": flags.tactile_movement_too_large,
            "too_many_steps": flags.too_many_steps,
            "error_too_large": flags.error_too_large,
            "peg_relative_z_mm": state.peg_relative_z_mm,
            "is_success": flags.is_success,
            "relative_motion_mm_deg": scene.relative_motion_mm_deg(),
            "gt_offset_mm_deg": state.offset.as_array(),
        }
        return {**info}


AnyInfo = dict[str, Any]


_OFFSET = "gt_offset_mm_deg"
_BEFORE = "achieved_goal_before"


class NoGoal(VitacError):
    """A goal interface was asked for around a task without offset, or a reward without the info of its env step."""


class InsertionGoal(gymnasium.Wrapper[Any, Any, Any, Any], gymnasium.utils.RecordConstructorArgs):
    """Gives an insertion task the entries `observation`, `achieved_goal` and `desired_goal`, and `compute_reward`.

    The achieved goal is the commanded offset from the hole [mm, deg], which is the truth: such a policy is for training
    others, not for submitting. The desired goal is no offset. `observation` is the task's own, flattened.

    Args:
        env: a task with the offset from its hole in the infos.
        tolerance: a replaced goal is reached where no number of the offset from it is larger [mm, deg]. The task's own
            goal is reached as the task says.
    """

    def __init__(self, env: gymnasium.Env[Any, Any], tolerance: float = 0.5) -> None:
        gymnasium.utils.RecordConstructorArgs.__init__(self, tolerance=tolerance)
        super().__init__(env)
        self._tolerance = tolerance
        self._before = np.zeros(0)
        task_env: Any = env.unwrapped
        offset = next((entry for entry in task_env.task.observables if entry.name == "gt_offset"), None)
        if offset is None:
            raise NoGoal(f"Expected a task with an offset from a hole, got {task_env.env_id}.")
        self._settings = task_env.settings
        goal = gymnasium.spaces.Box(-np.inf, np.inf, offset.shape, np.float64)
        self.observation_space = gymnasium.spaces.Dict(
            observation=flatten_space(env.observation_space), achieved_goal=goal, desired_goal=goal
        )

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, AnyInfo]:
        """Start an episode."""
        observation, info = self.env.reset(seed=seed, options=options)
        return self._with_goal(observation, info), info

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, AnyInfo]:
        """Play one env step; its info also has the offset before it, which the reward depends on."""
        before = self._before
        observation, reward, terminated, truncated, info = self.env.step(action)
        return self._with_goal(observation, info), reward, terminated, truncated, info | {_BEFORE: before}

    def compute_reward(
        self, achieved_goal: FloatArray, desired_goal: FloatArray, info: Mapping[str, Any] | Sequence[Mapping[str, Any]]
    ) -> Any:
        """Return the reward of an env step, or of several, as if the desired goal were the hole.

        With the task's own goal it is the task's own reward.

        Args:
            achieved_goal: offset after the env step, shape [k] or [n, k].
            desired_goal: of the same shape.
            info: of the env step; one for each of several.

        Raises:
            NoGoal: an info is not that of an env step.
        """
        if isinstance(info, Mapping):
            return self._reward(np.asarray(achieved_goal), np.asarray(desired_goal), info)
        rows = zip(np.asarray(achieved_goal), np.asarray(desired_goal), info, strict=True)
        return np.array([self._reward(*row) for row in rows])

    def _reward(self, achieved: FloatArray, desired: FloatArray, info: Mapping[str, Any]) -> float:
        if _BEFORE not in info:
            raise NoGoal("Expected the info of the env step, got none; let the buffer keep it: copy_info_dict=True.")
        failed = {
            name: bool(info.get(name, False))
            for name in ("force_too_large", "tactile_movement_too_large", "error_too_large")
        }
        left = achieved - desired
        near = not any(failed.values()) and bool((np.abs(left) <= self._tolerance).all())
        flags = Flags(**failed, is_success=near if desired.any() else bool(info["is_success"]))
        progress = norm((info[_BEFORE] - desired).tolist()) - norm(left.tolist())
        return insertion_reward(flags, self._settings, progress=progress, env_steps=int(info["steps"]))

    def _with_goal(self, observation: Any, info: AnyInfo) -> dict[str, Any]:
        self._before = np.array(info[_OFFSET])
        return {
            "observation": flatten(self.env.observation_space, observation),
            "achieved_goal": self._before,
            "desired_goal": np.zeros_like(self._before),
        }


def way_to_the_hole(offset_mm_deg: Sequence[float]) -> tuple[float, float, float]:
    """Return what takes an offset (x mm, y mm, theta deg) away: x and y in the gripper's own axes, and the angle."""
    x_mm, y_mm, theta_deg = offset_mm_deg
    sine, cosine = sine_cosine(radians(theta_deg))
    return -cosine * x_mm - sine * y_mm, sine * x_mm - cosine * y_mm, -theta_deg
