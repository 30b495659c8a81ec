"""What `gymnasium.make_vec` gives: environments of a task in processes that are forked when everything is loaded."""

from collections.abc import Callable, Sequence
from functools import partial, reduce
from typing import Any, NoReturn

import numpy as np
from gymnasium.vector import AsyncVectorEnv, AutoresetMode

from .making import AnyEnv, make

Wrapping = Callable[[AnyEnv], AnyEnv]


class ForkedVectorEnv(AsyncVectorEnv):
    """Environments of one task in processes of their own, which start at once and share what is loaded.

    Importing the simulation and loading its compiled kernels takes a second or more per process. Here this process does
    it once, by an env step in an environment of its own, and is then forked. Everything else is gymnasium's
    `AsyncVectorEnv`: seeds, autoreset, shared memory, and what happens where an environment fails.

    Args:
        env_id: registered id of the environments.
        num_envs: how many; more than there are cores evens out that env steps take unequally long.
        autoreset_mode: what starts the next episode after an end: the next env step (the default), the same one, or
            `reset` with a mask; TorchRL needs the second.
        env_wrappers: put around every environment, the first one innermost (`wrappers` of `make_vec` is gymnasium's own
            and serves its own vector environments only).
        **arguments: of every environment.
    """

    def __init__(
        self,
        env_id: str,
        num_envs: int = 1,
        autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
        env_wrappers: Sequence[Wrapping] = (),
        **arguments: Any,
    ) -> None:
        self._load(env_id, arguments)
        copies = [partial(_wrapped, env_id, env_wrappers, arguments)] * num_envs
        super().__init__(copies, context="fork", autoreset_mode=autoreset_mode)

    def __reduce__(self) -> NoReturn:
        """Refuse to be pickled or copied, as the processes would have to be.

        Raises:
            TypeError: always.
        """
        raise TypeError(
            "Environments in processes of their own cannot be copied or pickled. Copy a single environment, or make "
            'them in this process by `gymnasium.make_vec(..., vectorization_mode="sync")`.'
        )

    @staticmethod
    def _load(env_id: str, arguments: dict[str, Any]) -> None:
        env = make(env_id, **arguments)
        env.reset(seed=0)
        env.step(np.zeros(env.action_space.shape or (), dtype=np.float32))
        env.close()


def _wrapped(env_id: str, wrappers: Sequence[Wrapping], arguments: dict[str, Any]) -> AnyEnv:
    return reduce(lambda env, wrapper: wrapper(env), wrappers, make(env_id, **arguments))
