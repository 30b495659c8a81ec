"""TD3 as the challenge trained its baselines (challenge-facts 8), by Stable-Baselines3.

The actor sees what a policy sees; the critics see the truth in its place (asymmetric: Pinto et al. 2018). Importing
this module needs the extra `training`; `method` says so where it is missing.
"""

import io
from collections.abc import Callable
from contextlib import closing
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import torch
from stable_baselines3.common.callbacks import BaseCallback, EvalCallback
from stable_baselines3.common.logger import CSVOutputFormat, configure
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.noise import NormalActionNoise
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.td3.policies import Actor, TD3Policy

from ..files import Arrays, FileDamaged, load, not_saved, save, write_bytes
from ..progress import Progress
from ..run import OtherRun, Tell
from ..streams import Use, stream
from .gradients import CachedPointNet, ChallengeTD3
from .hyperparameters import HIDDEN, Hyperparameters
from .policy import PointNet, TactileActor, lock_actor, peg_actor
from .state import NumberedStarts, Training, env_steps_of

STATE = "state.npz"
"""File of all that a training goes on from."""


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

    make: Callable[[type[PointNet]], TactileActor]

    def __init__(self, **arguments: Any) -> None:
        super().__init__(**arguments)
        self.network = type(self).make(CachedPointNet)

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
    return ChallengeTD3(
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
            "optimizer_kwargs": {"fused": True},
        },
        seed=chosen.seed,
        device="cpu",
    )


class Keeper(BaseCallback):  # type: ignore[misc]
    """Keeps the model after so many env steps, and soon after that, between two episodes, all to go on from.

    Args:
        training: that is kept.
        folder: where the files are.
        every: env steps.
        name: of the files of the model.
        tell: is told how far the training is, a line each.
    """

    def __init__(self, training: Training, folder: Path, every: int, name: str, tell: Tell) -> None:
        super().__init__()
        self._training, self._folder, self._every, self._name, self._tell = training, folder, every, name, tell
        self._progress = Progress()

    def _on_training_start(self) -> None:
        self._training.begin_clock()
        self._kept = self.model.num_timesteps // self._every
        self._progress.left(self.model.num_timesteps, self.model._total_timesteps)

    def _on_rollout_start(self) -> None:
        due = self.model.num_timesteps // self._every
        if due > self._kept and self._training.starts.is_at_start:
            save(self._folder / STATE, self._training.state())
            self._kept = due
            total = self.model._total_timesteps
            left = self._progress.left(self.model.num_timesteps, total)
            self._tell(f"{self.model.num_timesteps} of {total} env steps{left}")

    def _on_step(self) -> bool:
        self.logger.record("time/cpu_s", round(self._training.cpu_s, 1))
        if self.num_timesteps % self._every == 0:
            write_bytes(
                self._folder / "checkpoints" / f"{self._name}_{self.num_timesteps}_steps.zip", packed(self.model)
            )
        return True


def train(
    task: str, chosen: Hyperparameters, make: Callable[[], Any], folder: Path, env_steps: int, tell: Tell
) -> Path:
    """Train until so many env steps are done, or go on, and return the saved model.

    Checkpoints, evaluations and a log lie beside it, and from the first checkpoint on all to go on from.

    Args:
        task: name of the task.
        chosen: hyperparameters.
        make: makes an environment.
        folder: of the training.
        env_steps: of the training.
        tell: is told how far the training is, a line each.

    Raises:
        OtherRun: the folder holds more env steps.
        NotSaved: the disk is full.
        FileDamaged: what to go on from is not what was written.
        TrainingDiverged: a loss is no number.
    """
    torch.set_num_threads(1)  # the bits must not depend on the number of cores
    before = _kept(folder / STATE)
    if before is not None and env_steps_of(before) > env_steps:
        raise OtherRun(
            f"{folder} holds a training of {env_steps_of(before)} env steps, expected at most {env_steps}; "
            "ask for more, or give another folder."
        )
    training = _new_training(task, chosen, make, folder)
    model = training.model
    keeper = Keeper(training, folder, chosen.checkpoint_env_steps, task, tell)
    try:
        with closing(model.logger):
            if before is not None:
                training.restore(before)
            model.learn(
                env_steps - model.num_timesteps,
                callback=[training.evaluation, keeper],  # a line of an evaluation has the time of the env step before
                log_interval=chosen.log_interval,
                reset_num_timesteps=False,
            )
    except OSError as error:
        raise not_saved(folder, error) from error
    path = folder / f"{task}.zip"
    write_bytes(path, packed(model))
    return path


def _kept(path: Path) -> Arrays | None:
    """Return all to go on from; None where nothing is kept yet."""
    if not path.exists():
        return None
    try:
        return load(path)
    except FileDamaged as error:
        raise FileDamaged(f"{error} The training then begins at 0 env steps, whatever its checkpoints.") from error


def _new_training(task: str, chosen: Hyperparameters, make: Callable[[], Any], folder: Path) -> Training:
    starts = NumberedStarts(make(), stream(chosen.seed, Use.COLLECT))
    held_out = NumberedStarts(make(), stream(chosen.seed, Use.CHOOSE), chosen.evaluation_episodes)
    evaluation = EvalCallback(
        Monitor(held_out),
        n_eval_episodes=chosen.evaluation_episodes,
        eval_freq=chosen.checkpoint_env_steps,
        log_path=str(folder),
        verbose=0,
    )
    model = new_model(task, chosen, starts)
    model.set_logger(configure(str(folder), ["csv", *(["tensorboard"] if find_spec("tensorboard") else [])]))
    log = next(each for each in model.logger.output_formats if isinstance(each, CSVOutputFormat))
    return Training(model=model, starts=starts, held_out=held_out, evaluation=evaluation, log=log)


def packed(model: Any) -> bytes:
    """Return the file that Stable-Baselines3 saves of a model."""
    file = io.BytesIO()
    model.save(file)
    return file.getvalue()
