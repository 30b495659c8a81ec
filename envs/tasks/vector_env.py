"""What `gymnasium.make_vec` gives: environments of a task in processes that are forked when everything is loaded."""

from functools import partial
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AsyncVectorEnv

from .making import make


class ForkedVectorEnv(AsyncVectorEnv):
    """Environments of one task in processes of their own, which start at once and share what is loaded.

    Importing the simulation and loading its compiled kernels takes a second or more per process. Here this process does
    it once, by an env step in an environment of its own, and is then forked. Everything else is gymnasium's
    `AsyncVectorEnv`: seeds, autoreset, shared memory, and what happens where an environment fails.

    Args:
        env_id: registered id of the environments.
        num_envs: how many; more than there are cores evens out that env steps take unequally long.
        **arguments: of every environment.
    """

    def __init__(self, env_id: str, num_envs: int = 1, **arguments: Any) -> None:
        self._load(env_id, arguments)
        super().__init__([partial(make, env_id, **arguments)] * num_envs, context="fork")

    @staticmethod
    def _load(env_id: str, arguments: dict[str, Any]) -> None:
        env: gymnasium.Env[Any, Any] = make(env_id, **arguments)
        env.reset(seed=0)
        env.step(np.zeros(env.action_space.shape or (), dtype=np.float32))
        env.close()
