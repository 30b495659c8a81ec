"""What `gymnasium.make` gives: the environment of a task with infos of one shape, whatever shape is played.

Vector environments stack the infos of their environments. Records and logs are made of the unwrapped environment, whose
infos have as many numbers as the shape has corners.
"""

from collections.abc import Mapping
from importlib import import_module
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from .registry import task_definitions

AnyEnv = gymnasium.Env[Any, Any]
AnyInfo = dict[str, Any]


def make(env_id: str, **arguments: Any) -> AnyEnv:
    """Return the environment of a task, with infos of one shape where the task says which entries differ."""
    task = task_definitions()[env_id]
    module, _, name = task.environment.partition(":")
    env: AnyEnv = getattr(import_module(module), name)(**arguments)
    return EqualInfoShapes(env, task.info_lengths) if task.info_lengths else env


class EqualInfoShapes(gymnasium.Wrapper[Any, Any, Any, Any], gymnasium.utils.RecordConstructorArgs):
    """Fills up entries of the info to one length by repeating their last number, as the marker flow does.

    The largest and the smallest number of an entry stay what they are.

    Args:
        env: whose infos.
        lengths: of the entries, by name.
    """

    def __init__(self, env: AnyEnv, lengths: Mapping[str, int]) -> None:
        gymnasium.utils.RecordConstructorArgs.__init__(self, lengths=dict(lengths))
        super().__init__(env)
        self._lengths = dict(lengths)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, AnyInfo]:
        """Start an episode."""
        observation, info = self.env.reset(seed=seed, options=options)
        return observation, self._filled(info)

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, AnyInfo]:
        """Play one env step."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        return observation, reward, terminated, truncated, self._filled(info)

    def _filled(self, info: AnyInfo) -> AnyInfo:
        return info | {name: _filled_up(info[name], length) for name, length in self._lengths.items()}


def _filled_up(numbers: NDArray[np.float64], length: int) -> NDArray[np.float64]:
    return np.concatenate([numbers, np.repeat(numbers[-1:], length - len(numbers))])
