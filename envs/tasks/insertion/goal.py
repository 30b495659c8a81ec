"""The goal interface of Gymnasium-Robotics around an insertion task, for methods that replace goals later (HER)."""

from collections.abc import Mapping, Sequence
from typing import Any

import gymnasium
import numpy as np
from gymnasium.spaces.utils import flatten, flatten_space
from numpy.typing import NDArray

from ...errors import VitacError
from ..ending import Flags
from .offset import norm
from .reward import insertion_reward

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
