"""All that a training by the challenge's method goes on from: networks, optimizers, replay buffer, random numbers, log.

It is taken between two episodes, so that it needs nothing of the physics: the next episode begins at a start that is
known by its number.
"""

import io
import json
from collections import deque
from dataclasses import dataclass
from pathlib import Path
from time import process_time, time_ns
from typing import Any

import gymnasium
import numpy as np
import torch
from stable_baselines3.common.callbacks import EvalCallback
from stable_baselines3.common.logger import CSVOutputFormat

from ..files import Arrays

_EVALUATED = ("evaluations_timesteps", "evaluations_results", "evaluations_length", "evaluations_successes")


class NumberedStarts(gymnasium.Wrapper[Any, Any, Any, Any]):
    """Random starts of a stream in the order of their numbers, whatever seed and options say.

    Args:
        env: whose starts they are.
        seed: of the stream.
        count: begin again after so many; None for never.
    """

    def __init__(self, env: Any, seed: int, count: int | None = None) -> None:
        super().__init__(env)
        self._seed, self._count = seed, count
        self.resets = 0
        self.is_at_start = False

    def reset(self, **_: Any) -> tuple[Any, dict[str, Any]]:
        """Begin the next one."""
        number = self.resets if self._count is None else self.resets % self._count
        self.resets += 1
        self.is_at_start = True
        return self.env.reset(options={"rng_seed": (self._seed, number)})

    def step(self, action: Any) -> Any:
        """Do an env step."""
        self.is_at_start = False
        return self.env.step(action)


@dataclass(kw_only=True, eq=False)
class Training:
    """A training in this process.

    Attributes:
        model: that learns.
        starts: of the episodes that it learns from.
        held_out: those of the evaluations.
        evaluation: that plays them.
        log: file of the log.
    """

    model: Any
    starts: NumberedStarts
    held_out: NumberedStarts
    evaluation: EvalCallback
    log: CSVOutputFormat

    def __post_init__(self) -> None:
        self._cpu_s_before, self._elapsed_ns_before = -process_time(), 0

    @property
    def cpu_s(self) -> float:
        """CPU time of the training, in all processes that it had one after the other [s]."""
        return self._cpu_s_before + process_time()

    def begin_clock(self) -> None:
        """Count the time of the processes before; Stable-Baselines3 has just set its clock to now."""
        self.model.start_time -= self._elapsed_ns_before
        self.model._num_timesteps_at_start = 0

    def state(self) -> Arrays:
        """Return all that the training goes on from.

        Raises:
            ValueError: an episode is under way.
        """
        if not self.starts.is_at_start:
            raise ValueError("An episode is under way; expected to be between two.")
        model, random = self.model, np.random.get_state(legacy=False)  # noqa: NPY002 - Stable-Baselines3 draws from it
        key = random["state"].pop("key")
        told = {
            "env_steps": model.num_timesteps,
            "gradient_steps": model._n_updates,
            "episodes": model._episode_num,
            "rewards": list(model.ep_info_buffer),
            "successes": np.asarray(model.ep_success_buffer).tolist(),
            "starts": self.starts.resets,
            "held_out_starts": self.held_out.resets,
            "evaluated": {name: np.asarray(getattr(self.evaluation, name)).tolist() for name in _EVALUATED},
            "log": Path(self.log.file.name).read_text(encoding="utf-8"),
            "cpu_s": self.cpu_s,
            "elapsed_ns": time_ns() - model.start_time,
            "random": random,
            "random_of_actions": model.action_space.np_random.bit_generator.state,
        }
        return {
            "told": np.array(json.dumps(told)),
            "random_key": key,
            "random_of_torch": torch.get_rng_state().numpy(),
            "networks": np.frombuffer(_networks(model), np.uint8),
            **_transitions(model.replay_buffer),
        }

    def restore(self, arrays: Arrays) -> None:
        """Go on from a state, with a model that has learned nothing yet."""
        told, model = json.loads(str(arrays["told"])), self.model
        model.num_timesteps, model._n_updates = told["env_steps"], told["gradient_steps"]
        model._episode_num = told["episodes"]
        model.ep_info_buffer = deque(told["rewards"], maxlen=model._stats_window_size)
        model.ep_success_buffer = deque(told["successes"], maxlen=model._stats_window_size)
        self.starts.resets = told["starts"] - 1  # the reset of the first observation is done again
        self.held_out.resets = told["held_out_starts"]
        self.evaluation.n_calls = told["env_steps"]
        for name, values in told["evaluated"].items():
            setattr(self.evaluation, name, values)
        self.log.file.write(told["log"])
        self.log.file.flush()  # the next state reads it
        self.log.keys = told["log"].partition("\n")[0].split(",") if told["log"] else []
        self._cpu_s_before += told["cpu_s"]
        self._elapsed_ns_before = told["elapsed_ns"]
        _restore_networks(model, arrays["networks"].tobytes())
        _restore_transitions(model.replay_buffer, arrays)
        told["random"]["state"]["key"] = arrays["random_key"]
        np.random.set_state(told["random"])  # noqa: NPY002
        torch.set_rng_state(torch.from_numpy(arrays["random_of_torch"]))
        model.action_space.np_random.bit_generator.state = told["random_of_actions"]


def env_steps_of(arrays: Arrays) -> int:
    """Return after how many env steps a state was taken."""
    return int(json.loads(str(arrays["told"]))["env_steps"])


def _networks(model: Any) -> bytes:
    """Return the networks and what their optimizers remember, as a file of torch."""
    file = io.BytesIO()
    optimizers = [network.optimizer.state_dict() for network in (model.actor, model.critic)]
    torch.save([model.policy.state_dict(), *optimizers], file)
    return file.getvalue()


def _restore_networks(model: Any, data: bytes) -> None:
    policy, *optimizers = torch.load(io.BytesIO(data), weights_only=True)
    model.policy.load_state_dict(policy)
    for network, state in zip((model.actor, model.critic), optimizers, strict=True):
        network.optimizer.load_state_dict(state)


def _transitions(buffer: Any) -> Arrays:
    """Return what the replay buffer holds."""
    held = buffer.buffer_size if buffer.full else buffer.pos
    return {
        "buffer": np.array([buffer.pos, buffer.full]),
        **{name: kept[:held] for name, kept in _kept(buffer).items()},
    }


def _restore_transitions(buffer: Any, arrays: Arrays) -> None:
    buffer.pos, buffer.full = int(arrays["buffer"][0]), bool(arrays["buffer"][1])
    for name, kept in _kept(buffer).items():
        kept[: len(arrays[name])] = arrays[name]


def _kept(buffer: Any) -> Arrays:
    """Return the arrays of the replay buffer by name."""
    observed = {
        f"{name}/{key}": array
        for name in ("observations", "next_observations")
        for key, array in getattr(buffer, name).items()
    }
    return {**observed, **{name: getattr(buffer, name) for name in ("actions", "rewards", "dones", "timeouts")}}
