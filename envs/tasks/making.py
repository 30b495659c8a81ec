"""What `gymnasium.make` and `make_vec` give: environments whose infos have one shape, and copies of them in processes.

Records and logs are made of the unwrapped environment, whose infos have as many numbers as the shape has corners.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import partial, reduce
from importlib import import_module
from typing import Any, NoReturn

import gymnasium
import numpy as np
from gymnasium.vector import AsyncVectorEnv, AutoresetMode
from numpy.typing import NDArray

from .definition import EndReason
from .registry import task_definitions
from .settings import SettingsError, UnknownSetting

AnyEnv = gymnasium.Env[Any, Any]
AnyInfo = dict[str, Any]


class UnexpectedArgument(SettingsError, TypeError):
    """`make` got a keyword argument that the task does not have; the message has Python's own words and the nearest.

    A `TypeError`, because libraries that try arguments of their own, as TorchRL does, look for one.
    """


def make(env_id: str, **arguments: Any) -> AnyEnv:
    """Return the environment of a task, with infos of one shape where the task says which entries differ.

    Raises:
        UnexpectedArgument: the task has no such argument.
    """
    task = task_definitions()[env_id]
    module, _, name = task.environment.partition(":")
    try:
        env: AnyEnv = getattr(import_module(module), name)(**arguments)
    except UnknownSetting as unknown:
        raise UnexpectedArgument(
            f"{env_id} got an unexpected keyword argument '{unknown.name}'; {unknown.hint}"
        ) from None
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


class NumericInfos(gymnasium.Wrapper[Any, Any, Any, Any], gymnasium.utils.RecordConstructorArgs):
    """Makes an info one of numbers and arrays, each always of one type, as data sets and TorchRL need it.

    `end_reason` is 0 while an episode is running, afterwards the position in `EndReason`, from 1. The solver's reports
    are left out.
    """

    def __init__(self, env: AnyEnv) -> None:
        gymnasium.utils.RecordConstructorArgs.__init__(self)
        super().__init__(env)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, AnyInfo]:
        """Start an episode."""
        observation, info = self.env.reset(seed=seed, options=options)
        return observation, _numeric(info)

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, AnyInfo]:
        """Play one env step."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        return observation, reward, terminated, truncated, _numeric(info)


def _numeric(info: AnyInfo) -> AnyInfo:
    reason = info["end_reason"]
    number = 0 if reason is None else 1 + list(EndReason).index(EndReason(reason))
    return {name: value for name, value in info.items() if name != "step_reports"} | {"end_reason": number}


def _filled_up(numbers: NDArray[np.float64], length: int) -> NDArray[np.float64]:
    return np.concatenate([numbers, np.repeat(numbers[-1:], length - len(numbers))])


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
