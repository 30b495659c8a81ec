"""TD3 as the challenge trained its baselines (challenge-facts 8), by Stable-Baselines3.

The actor sees what a policy sees; the critics see the truth in its place (asymmetric: Pinto et al. 2018). Importing
this module needs the extra `training`; `method` says so where it is missing.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import torch
from stable_baselines3 import TD3
from stable_baselines3.common.callbacks import CheckpointCallback, EvalCallback
from stable_baselines3.common.logger import configure
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.noise import NormalActionNoise
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.td3.policies import Actor, TD3Policy

from ..streams import Use, stream
from .hyperparameters import HIDDEN, Hyperparameters
from .policy import TactileActor, lock_actor, peg_actor


class TruthExtractor(BaseFeaturesExtractor):  # type: ignore[misc]
    """What the critics see beside the action: the privileged observations, one after the other."""

    def __init__(self, observation_space: Any, keys: tuple[str, ...]) -> None:
        super().__init__(observation_space, sum(int(np.prod(observation_space[key].shape)) for key in keys))
        self._keys = keys

    def forward(self, observations: Any) -> Any:
        """Return the truth, shape [b, n]."""
        return torch.cat([observations[key].flatten(1) for key in self._keys], dim=1)


class ChallengeActor(Actor):  # type: ignore[misc]
    """The challenge's actor in the place of Stable-Baselines3's own, which stays unused in the state dict."""

    make: Callable[[], TactileActor]

    def __init__(self, **arguments: Any) -> None:
        super().__init__(**arguments)
        self.network = type(self).make()

    def forward(self, obs: Any) -> Any:
        """Return the actions."""
        return self.network(obs["marker_flow"].float(), obs["relative_motion"].float())


class _PegActor(ChallengeActor):
    make = staticmethod(peg_actor)


class _LockActor(ChallengeActor):
    make = staticmethod(lock_actor)


class TD3PolicyForPointFlowEnv(TD3Policy):  # type: ignore[misc]
    """Peg insertion."""

    def make_actor(self, features_extractor: Any = None) -> Any:
        """Return an actor of the challenge's."""
        return _PegActor(**self._update_features_extractor(self.actor_kwargs, features_extractor)).to(self.device)


class TD3PolicyForLongOpenLockPointFlowEnv(TD3Policy):  # type: ignore[misc]
    """Lock opening."""

    def make_actor(self, features_extractor: Any = None) -> Any:
        """Return an actor of the challenge's."""
        return _LockActor(**self._update_features_extractor(self.actor_kwargs, features_extractor)).to(self.device)


POLICIES = {"peg-insertion": TD3PolicyForPointFlowEnv, "lock-opening": TD3PolicyForLongOpenLockPointFlowEnv}


def new_model(task: str, chosen: Hyperparameters, env: Any) -> Any:
    """Return an untrained model of a task."""
    actions = env.action_space.shape
    return TD3(
        POLICIES[task],
        env,
        learning_rate=chosen.learning_rate,
        buffer_size=chosen.buffer_size,
        learning_starts=chosen.learning_starts,
        batch_size=chosen.batch_size,
        tau=chosen.tau,
        gamma=chosen.discount,
        train_freq=chosen.env_steps_per_training,
        gradient_steps=-1,
        action_noise=NormalActionNoise(np.zeros(actions), np.full(actions, chosen.action_noise)),
        policy_delay=chosen.policy_delay,
        target_policy_noise=chosen.target_noise,
        target_noise_clip=chosen.target_noise_clip,
        policy_kwargs={
            "net_arch": [HIDDEN, HIDDEN],
            "features_extractor_class": TruthExtractor,
            "features_extractor_kwargs": {"keys": chosen.truths},
        },
        seed=chosen.seed,
        device="cpu",
    )


class HeldOutStarts(gymnasium.Wrapper[Any, Any, Any, Any]):
    """The same few random starts one after the other, over and over; no training learns from their stream.

    Args:
        env: whose starts they are.
        chosen: says of which training, and how many.
    """

    def __init__(self, env: Any, chosen: Hyperparameters) -> None:
        super().__init__(env)
        self._stream, self._count, self._resets = stream(chosen.seed, Use.CHOOSE), chosen.evaluation_episodes, 0

    def reset(self, **_: Any) -> tuple[Any, dict[str, Any]]:
        """Begin the next one, whatever seed and options say."""
        number = self._resets % self._count
        self._resets += 1
        return self.env.reset(options={"rng_seed": (self._stream, number)})


def train(
    task: str, chosen: Hyperparameters, make: Callable[[], Any], folder: Path, env_steps: int, formats: list[str]
) -> Path:
    """Train for so many env steps, and return the saved model; checkpoints, evaluations and a log lie beside it.

    Args:
        task: name of the task.
        chosen: hyperparameters.
        make: makes an environment.
        folder: of the training.
        env_steps: of the training.
        formats: of the log.
    """
    model = new_model(task, chosen, make())
    logger = configure(str(folder), formats)
    model.set_logger(logger)
    every = chosen.checkpoint_env_steps
    callbacks = [
        CheckpointCallback(every, str(folder / "checkpoints"), name_prefix=task),
        EvalCallback(
            Monitor(HeldOutStarts(make(), chosen)),
            n_eval_episodes=chosen.evaluation_episodes,
            eval_freq=every,
            log_path=str(folder),
            verbose=0,
        ),
    ]
    try:
        model.learn(env_steps, callback=callbacks, log_interval=chosen.log_interval)
    finally:
        logger.close()
    path = folder / f"{task}.zip"
    model.save(path)
    return path
