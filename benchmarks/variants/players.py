"""Who plays the variants: an example submission, and a planner that knows the truth and simulates ahead."""

import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from pkgutil import resolve_name
from runpy import run_path
from typing import Any, Protocol

import numpy as np
from vitac.envs.scene.measured_pose import held_pose_mm_deg
from vitac.evaluator.episodes.episode import make_environment
from vitac.evaluator.tracks import Task

EXAMPLES = Path(__file__).parents[2] / "examples"


@dataclass(frozen=True, kw_only=True)
class Plan:
    """How to go to the target.

    Attributes:
        gain: part of the way that is left, gone in every env step.
        last_waits: whether the last number of an action, such as the lift of a key, waits until the others are done.
        measured: whether the way begins where the part is measured to be, not where it is commanded to be.
        dither: standard deviation of what is added to every number of an action.
        seed: of that.
    """

    gain: float
    measured: bool
    last_waits: bool = False
    dither: float = 0.0
    seed: int = 0


PLANS = (
    *(Plan(gain=gain, measured=measured) for gain in (1.0, 0.6, 1.3) for measured in (False, True)),
    *(Plan(gain=gain, measured=True, last_waits=True) for gain in (1.0, 0.5)),
    *(Plan(gain=1.0, measured=True, dither=0.3, seed=seed) for seed in range(10)),
)
"""What the planner tries, in this order, until one succeeds."""


_DONE = 0.05


class Player(Protocol):
    """Plays whole episodes of one task."""

    def play(self, options: Mapping[str, Any]) -> dict[str, Any]:
        """Return the last info of an episode."""


class Example:
    """An example submission, in this process.

    Args:
        task: that is played.
        folder: of the example, with `policy.py`.
        named: name of the task that the policy is given, by default its own.
        settings: in place of the task's own.
    """

    def __init__(self, task: Task, folder: Path, *, named: str, **settings: Any) -> None:
        sys.path.insert(0, str(folder))
        self._policy = run_path(str(folder / "policy.py"))["Policy"]()
        self._named = named
        self._env: Any = make_environment(task, settings=settings)

    def play(self, options: Mapping[str, Any]) -> dict[str, Any]:
        """Play as in an evaluation."""
        observation, info = self._env.reset(options=options)
        self._policy.reset(self._named)
        while info["end_reason"] is None:
            try:
                action = self._policy.act(observation)
            except (ArithmeticError, IndexError, ValueError, np.linalg.LinAlgError):
                return {**info, "end_reason": "policy_failed"}
            observation, _, _, _, info = self._env.step(action)
        return dict(info)


class Planner:
    """Knows the exact offset and the exact parts, and tries plans in the simulation before it plays one.

    Args:
        task: that is played.
        settings: in place of the task's own.
    """

    def __init__(self, task: Task, **settings: Any) -> None:
        self._env: Any = make_environment(task, observation_keys=(), settings=settings)
        assert task.definition.guided_motion is not None  # noqa: S101 - our tasks have one
        self._way = resolve_name(task.definition.guided_motion)

    def play(self, options: Mapping[str, Any]) -> dict[str, Any]:
        """Play the first plan that succeeds, or the last."""
        _, start = self._env.reset(options=options)
        snapshot = self._env.snapshot()
        for plan in PLANS:
            self._env.restore(snapshot)
            info = self._follow(plan, start)
            if info["is_success"]:
                break
        return info

    def _follow(self, plan: Plan, info: dict[str, Any]) -> dict[str, Any]:
        """Return the last info of the episode, played by a plan."""
        random = np.random.default_rng(plan.seed)
        while info["end_reason"] is None:
            way = plan.gain * self._way({}, self._measured(info) if plan.measured else info)
            if plan.last_waits and np.abs(way[:-1]).max() > _DONE:
                way[-1] = 0.0
            action = way + plan.dither * random.standard_normal(len(way))
            *_, info = self._env.step(np.clip(action, -1.0, 1.0).astype(np.float32))
        return info

    def _measured(self, info: dict[str, Any]) -> dict[str, Any]:
        """Return the info of an insertion with the offset of the peg's lower end in place of the commanded one."""
        if "gt_offset_mm_deg" not in info:
            return info  # The info of the lock has measured teeth.
        scene = self._env.task_scene
        x_mm, y_mm, _, _, _, theta_deg = held_pose_mm_deg(scene.grasped)
        target = getattr(scene, "target", None)
        offset = info["gt_offset_mm_deg"].copy()
        offset[:3] = x_mm, y_mm - (target.y_mm if target else 0.0), theta_deg
        return {**info, "gt_offset_mm_deg": offset}
