"""Who plays the variants: an example submission, and a planner that knows the truth and simulates ahead."""

import sys
from collections.abc import Mapping
from pathlib import Path
from runpy import run_path
from typing import Any, Protocol

import numpy as np
from vitac.evaluator.episodes.episode import make_environment
from vitac.evaluator.tracks import Task
from vitac.training.demonstrations.expert import Expert

EXAMPLES = Path(__file__).parents[2] / "examples"


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
    """The expert with the truth, as a player.

    Args:
        task: that is played.
        settings: in place of the task's own.
    """

    def __init__(self, task: Task, **settings: Any) -> None:
        self._expert = Expert(task, **settings)

    def play(self, options: Mapping[str, Any]) -> dict[str, Any]:
        """Play the first plan that succeeds, or the last."""
        return dict(self._expert.play(options).info)
