"""Base of the environments that insert a peg: reward, info, goals like Gymnasium-Robotics', the way to the hole."""

from collections.abc import Mapping, Sequence
from math import radians
from typing import Any, TypedDict, TypeVar

import gymnasium
import numpy as np
from gymnasium.spaces.utils import flatten, flatten_space
from numpy.typing import NDArray
from vitac.errors import VitacError

from ...deterministic_math import sine_cosine
from ..definition import Flags
from ..task_env import Info, TactileTaskEnv
from .interface import PegOffset, norm
from .scene import InsertionScene, InsertionSettings


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
SettingsT = TypeVar("SettingsT", bound=InsertionSettings)


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


FloatArray = NDArray[np.float64]
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
