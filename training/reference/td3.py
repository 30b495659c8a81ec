"""Trains as the challenge trained its baselines, from the hyperparameters to a submission.

Read it from top to bottom: hyperparameters, networks, gradient step, the training loop (`Training.learn`), its state,
and last the encoder that computes gradients fast. Stable-Baselines3 keeps networks, optimizers and replay buffer, and
writes the files of models. The actor sees what a policy sees; the critics see the truth in its place (asymmetric: Pinto
et al. 2018). Importing this module without torch or Stable-Baselines3 raises `TrainingPackagesMissing`.
"""

import csv
import io
import json
import shutil
from collections import defaultdict
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field, replace
from importlib.metadata import version
from pathlib import Path
from time import process_time, time
from typing import Any

import gymnasium
import numpy as np
import vitac.envs  # noqa: F401 - registers the environments
from vitac.envs.extras import install_command
from vitac.envs.tactile.design import SensorDesign
from vitac.envs.tasks.settings import Fidelity, find_fidelity
from vitac.errors import VitacError
from vitac.evaluator.tracks import load_track

from ..files import Arrays, FileDamaged, load, save, write_bytes, write_text
from ..learning.network import TrainingDiverged
from ..log import Charts
from ..progress import TrainingProgress
from ..run import OtherRun, Tell, claimed
from ..sensor import make_sensor
from ..streams import Use, stream


class TrainingPackagesMissing(VitacError):
    """The challenge's method needs packages that are not installed; the message says how to install them."""


try:
    import torch
    from stable_baselines3 import TD3
    from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
    from stable_baselines3.td3.policies import Actor, TD3Policy
    from torch import nn
    from torch.nn import functional

    from .policy import ACTORS, PointNet
except ModuleNotFoundError as error:
    raise TrainingPackagesMissing(
        f"The challenge's method needs {error.name}, which is not installed. Run it as ./vitac --torch train "
        "reference, which installs it with torch's build for CPUs; or install what it needs by: "
        f"{install_command('training')}"
    ) from error


class UnknownReferenceTask(VitacError):
    """The challenge's method is not known for this task; choose one that the message names."""


class TrainingDeviceMissing(VitacError):
    """torch finds no such device on this machine; choose another, or install torch's build for it."""


@dataclass(frozen=True, kw_only=True)
class Hyperparameters:
    """How a task is trained; the defaults are common to all tasks."""

    env_id: str
    track: str  # of the submission
    env_steps: int  # length of the training
    truths: tuple[str, ...]  # privileged observations that the critics see
    policy_delay: int  # gradient steps of the critics for one of the actor
    settings: Mapping[str, Any] = field(default_factory=dict)  # of the environment, other than its defaults
    buffer_size: int = 10_000  # transitions in the replay buffer
    learning_starts: int = 1000  # env steps with random actions, before the first gradient step
    env_steps_per_training: int = 2  # env steps between two trainings, and gradient steps of each
    batch_size: int = 128  # transitions of a gradient step
    learning_rate: float = 3e-4  # of Adam
    target_noise: float = 0.5  # standard deviation of the noise on the next action
    target_noise_clip: float = 1.0
    action_noise: float = 0.5  # standard deviation of the noise on the action that is played
    discount: float = 0.99  # of the reward of the next env step
    tau: float = 0.005  # how far the target networks move towards the networks at each step of the actor
    seed: int = 0
    checkpoint_env_steps: int = 2000  # env steps between two checkpoints, each with an evaluation
    evaluation_episodes: int = 50  # starts of an evaluation; nothing is learned from them
    log_interval: int = 10  # episodes between two lines of the log
    fidelity: Fidelity = Fidelity.FULL  # of the episodes that are learned from; evaluations are played at full fidelity
    device: str = "cpu"  # of torch, where the networks learn


HYPERPARAMETERS = {
    "peg-insertion": Hyperparameters(
        env_id="ViTac/PegInsertion-v1", track="track_1", env_steps=400_000, truths=("gt_offset",), policy_delay=5
    ),
    "lock-opening": Hyperparameters(
        env_id="ViTac/LockOpening-v1", track="track_1", env_steps=80_000, truths=("key1", "key2"), policy_delay=2
    ),
    "fusion-insertion": Hyperparameters(
        env_id="ViTac/FusionInsertion-v1",
        track="track_2",
        env_steps=100_000,
        truths=("gt_offset", "relative_motion", "gt_direction"),
        policy_delay=2,
        settings={"insertion_depth_mm": 2.0},
        buffer_size=5000,
        checkpoint_env_steps=5000,
    ),
    "sensor-design": Hyperparameters(
        env_id="ViTac/PegInsertion-v1",
        track="track_3",
        env_steps=200_000,
        truths=("gt_offset",),
        policy_delay=5,
        buffer_size=20_000,
    ),
}
CRITIC_LAYERS = (256, 256)


class ChallengeActor(Actor):  # type: ignore[misc] # torch is not there when types are checked
    """The challenge's actor in place of the one of Stable-Baselines3, which stays unused in the state dict."""

    def __init__(self, task: str, **arguments: Any) -> None:
        super().__init__(**arguments)
        self.network = ACTORS[task](encoder=CachedPointNet)

    def forward(self, obs: Any) -> Any:
        """Return the actions."""
        return self.network(*(obs[key].float() for key in self.network.observed))


class TruthExtractor(BaseFeaturesExtractor):  # type: ignore[misc]
    """Makes what the critics see beside the action: the privileged observations, one after the other."""

    def __init__(self, observation_space: Any, keys: tuple[str, ...]) -> None:
        super().__init__(observation_space, sum(int(np.prod(observation_space[key].shape)) for key in keys))
        self._keys = keys

    def forward(self, observations: Any) -> Any:
        """Return the truth, shape [b, n]."""
        return torch.cat([observations[key].flatten(1) for key in self._keys], dim=1)


class ChallengePolicy(TD3Policy):  # type: ignore[misc]
    """Actor, critics and their target networks of a task."""

    def __init__(self, *arguments: Any, task: str, **named: Any) -> None:
        self._task = task
        super().__init__(*arguments, **named)

    def make_actor(self, features_extractor: Any = None) -> Any:
        """Return an untrained actor."""
        arguments = self._update_features_extractor(self.actor_kwargs, features_extractor)
        return ChallengeActor(self._task, **arguments).to(self.device)


def new_model(task: str, chosen: Hyperparameters, env: Any) -> Any:
    """Return the untrained networks of a task with their optimizers and an empty replay buffer."""
    return TD3(
        ChallengePolicy,
        env,
        learning_rate=chosen.learning_rate,
        buffer_size=chosen.buffer_size,
        learning_starts=chosen.learning_starts,
        batch_size=chosen.batch_size,
        tau=chosen.tau,
        gamma=chosen.discount,
        train_freq=chosen.env_steps_per_training,
        gradient_steps=-1,
        policy_delay=chosen.policy_delay,
        target_policy_noise=chosen.target_noise,
        target_noise_clip=chosen.target_noise_clip,
        policy_kwargs={
            "task": task,
            "net_arch": list(CRITIC_LAYERS),
            "features_extractor_class": TruthExtractor,
            "features_extractor_kwargs": {"keys": chosen.truths},
            "optimizer_kwargs": {"fused": True},
        },
        seed=chosen.seed,
        device=chosen.device,
    )


def gradient_step(model: Any, chosen: Hyperparameters, number: int) -> dict[str, float]:
    """Take a gradient step, and return the losses. It equals that of Stable-Baselines3 within rounding.

    Args:
        model: its networks learn from its replay buffer.
        chosen: hyperparameters.
        number: of the gradient step, from 1.

    Raises:
        TrainingDiverged: a loss is no number.
    """
    batch = model.replay_buffer.sample(chosen.batch_size)
    targets = _target_values(model, batch, chosen)
    values = model.critic(batch.observations, batch.actions)
    critic_loss = sum(functional.mse_loss(each, targets) for each in values)
    losses = {"critic_loss": _descend("critic", model.critic, critic_loss, number)}
    if number % chosen.policy_delay == 0:
        model.critic.requires_grad_(False)
        actor_loss = -model.critic.q1_forward(batch.observations, model.actor(batch.observations)).mean()
        losses["actor_loss"] = _descend("actor", model.actor, actor_loss, number)
        model.critic.requires_grad_(True)
        _move_target_networks(model, chosen.tau)
    return losses


def _target_values(model: Any, batch: Any, chosen: Hyperparameters) -> Any:
    """Return what the critics should say, shape [b, 1] (Fujimoto et al. 2018, equations 10 and 14).

    After the last env step of an episode there is no next action, so none is computed.
    """
    with torch.no_grad():
        noise = torch.empty(batch.actions.shape).normal_(0, chosen.target_noise)  # the same draws for every device
        noise = noise.clamp_(-chosen.target_noise_clip, chosen.target_noise_clip).to(batch.actions.device)
        continues = batch.dones[:, 0] < 1
        observations = {key: value[continues] for key, value in batch.next_observations.items()}
        actions = (model.actor_target(observations) + noise[continues]).clamp(-1, 1)
        next_values = torch.cat(model.critic_target(observations, actions), dim=1).amin(dim=1, keepdim=True)
        targets = batch.rewards.clone()
        targets[continues] += chosen.discount * next_values
        return targets


def _descend(name: str, network: Any, loss: Any, number: int) -> float:
    """Take a step of a network's optimizer, and return the loss."""
    value = float(loss.item())
    if not np.isfinite(value):
        raise TrainingDiverged(
            f"The loss of the {name} is {value} in gradient step {number}; expected a finite number."
        )
    network.optimizer.zero_grad()
    loss.backward()
    network.optimizer.step()
    return value


def _move_target_networks(model: Any, tau: float) -> None:
    with torch.no_grad():
        for network, target in ((model.critic, model.critic_target), (model.actor, model.actor_target)):
            for slow, fast in zip(target.parameters(), network.parameters(), strict=True):
                slow.lerp_(fast, tau)


def train_reference(
    task: str,
    folder: Path,
    *,
    env_steps: int | None = None,
    seed: int = 0,
    sensor: Path | None = None,
    fidelity: str = Fidelity.FULL.value,
    device: str = "cpu",
    tell: Tell = lambda _: None,
) -> Path:
    """Train as the challenge did, or continue a training, and return a submission.

    Args:
        task: name of the task.
        folder: a folder for the training: its checkpoints, evaluations, log and state, and `submission/`.
        env_steps: in place of the published number.
        seed: of the training.
        sensor: folder of the team's own sensor, for the task of Track 3.
        fidelity: of the episodes that are learned from, "full" or "training"; evaluations are played at full fidelity.
        device: of torch, such as `cuda`. Only `cpu` repeats to the bit.
        tell: receives lines about the progress.

    Raises:
        UnknownReferenceTask: the task is unknown.
        SettingsError: the fidelity is unknown, or is not full and there is a sensor.
        TrainingDeviceMissing: torch finds no such device.
        SensorMismatch: the task needs a sensor, or plays with the challenge's.
        SensorRejected: the sensor breaks a rule.
        OtherRun: the folder is that of another training or version, or holds more env steps, or another process trains
            there.
        StreamRefused: an official list has the seed of a stream of this training.
        NotSaved: the disk is full.
        FileDamaged: the stored state is damaged.
        TrainingDiverged: a loss is no number; the stored state can be continued.
    """
    if task not in HYPERPARAMETERS:
        raise UnknownReferenceTask(f"The task is '{task}', expected one of {', '.join(HYPERPARAMETERS)}.")
    _refuse_missing_device(device)
    found_fidelity = find_fidelity(fidelity, has_own_gel=sensor is not None)
    chosen = replace(HYPERPARAMETERS[task], seed=seed, fidelity=found_fidelity, device=device)
    made = make_sensor(load_track(chosen.track), task, sensor)
    design, digest = (made.design(), made.digest) if made else (None, None)
    identity = {"task": task, **asdict(chosen), "sensor": digest}
    versions = {name: version(name) for name in ("torch", "stable_baselines3")}
    with claimed(folder, identity | versions, tell), Charts(folder, tell) as charts:
        training = Training(task, chosen, design, folder, charts, tell)
        training.learn(env_steps or chosen.env_steps)
        return training.write_submission(sensor)


def _refuse_missing_device(name: str) -> None:
    try:
        torch.empty(0, device=name)
    except (RuntimeError, AssertionError) as error:  # what torch raises depends on its build
        raise TrainingDeviceMissing(
            f"torch cannot use the device '{name}' here: expected cpu, or cuda where torch {torch.__version__} finds a "
            f"GPU. It says: {str(error).splitlines()[0]}"
        ) from error


def make_env(
    task: str, chosen: Hyperparameters, design: SensorDesign | None, fidelity: Fidelity = Fidelity.FULL
) -> Any:
    """Return an environment that shows what the actor and the critics see."""
    keys = dict.fromkeys((*ACTORS[task]().observed, *chosen.truths))
    return gymnasium.make(
        chosen.env_id,
        disable_env_checker=True,
        privileged=True,
        observation_keys=tuple(keys),
        sensor=design,
        fidelity=fidelity.value,
        **chosen.settings,
    )


@dataclass(kw_only=True)
class TrainingHistory:
    """What a training has done so far, in all its processes one after the other."""

    env_steps: int = 0
    gradient_steps: int = 0
    episodes: int = 0
    recent_episodes: list[dict[str, float]] = field(default_factory=list)
    evaluations: list[dict[str, Any]] = field(default_factory=list)
    log: list[dict[str, float]] = field(default_factory=list)
    cpu_s: float = 0.0
    elapsed_s: float = 0.0


RECENT_EPISODES = 100
"""The log has means over as many."""
LOG_COLUMNS = (
    *("time/total_timesteps", "time/episodes", "time/cpu_s", "time/time_elapsed", "time/fps"),
    *("rollout/ep_rew_mean", "rollout/ep_len_mean", "rollout/success_rate"),
    *("train/n_updates", "train/critic_loss", "train/actor_loss"),
    *("eval/mean_reward", "eval/mean_ep_length", "eval/success_rate"),
)
"""Names as in the logs of Stable-Baselines3."""
STATE_FILE = "state.npz"


class Training:
    """A training in this process; it continues what is stored in the folder.

    Args:
        task: name of the task.
        chosen: hyperparameters.
        design: of the team's own sensor, if the task has one.
        folder: of the training.
        charts: for TensorBoard.
        tell: receives lines about the progress.

    Raises:
        FileDamaged: the stored state is damaged.
    """

    def __init__(
        self,
        task: str,
        chosen: Hyperparameters,
        design: SensorDesign | None,
        folder: Path,
        charts: Charts,
        tell: Tell,
    ) -> None:
        torch.set_num_threads(1)  # the bits must not depend on the number of cores
        self.task, self.chosen, self.folder, self.charts, self.tell = task, chosen, folder, charts, tell
        self.env = make_env(task, chosen, design, chosen.fidelity)
        self.held_out_env = make_env(task, chosen, design)
        self.model = new_model(task, chosen, self.env)
        self.history = TrainingHistory()
        self._losses: dict[str, list[float]] = defaultdict(list)
        if (folder / STATE_FILE).exists():
            self._restore()
        self._stored_env_steps = self.history.env_steps
        self._cpu_s_before = self.history.cpu_s - process_time()
        self._elapsed_s_before = self.history.elapsed_s - time()

    def learn(self, env_steps: int) -> None:
        """Play and learn until the training has a number of env steps; write checkpoints, evaluations, log and state.

        Raises:
            OtherRun: the training has more env steps already.
            NotSaved: the disk is full.
            TrainingDiverged: a loss is no number.
        """
        chosen, history, buffer = self.chosen, self.history, self.model.replay_buffer
        if history.env_steps > env_steps:
            raise OtherRun(
                f"{self.folder} holds a training of {history.env_steps} env steps, expected at most {env_steps}; "
                "ask for more, or give another folder."
            )
        progress = TrainingProgress()
        progress.left(history.env_steps, env_steps)
        episode: list[float] = []
        while history.env_steps < env_steps:
            if not episode:
                self._store_when_due(env_steps, progress)
                observation, _ = self.env.reset(options=self._start(Use.COLLECT, history.episodes))
            action = self._noisy_action(observation)
            next_observation, reward, terminated, truncated, info = self.env.step(action)
            buffer.add(observation, next_observation, action, reward, terminated, [{}])
            observation = next_observation
            episode.append(float(reward))
            history.env_steps += 1
            if history.env_steps % chosen.checkpoint_env_steps == 0:
                self._evaluate()
                self._write_model(self.folder / "checkpoints" / f"{self.task}_{history.env_steps}_steps.zip")
            if terminated or truncated:
                self._end_episode(episode, info)
                episode = []
            if history.env_steps > chosen.learning_starts and history.env_steps % chosen.env_steps_per_training == 0:
                for _ in range(chosen.env_steps_per_training):
                    history.gradient_steps += 1
                    for name, loss in gradient_step(self.model, chosen, history.gradient_steps).items():
                        self._losses[name].append(loss)
        self._write_model(self.folder / f"{self.task}.zip")

    def _start(self, use: Use, number: int) -> dict[str, Any]:
        return {"rng_seed": (stream(self.chosen.seed, use), number)}

    def _noisy_action(self, observation: Mapping[str, Any]) -> Any:
        """Return the action to be played: a random one at the beginning, that of the actor later."""
        if self.history.env_steps < self.chosen.learning_starts:
            action = self.model.action_space.sample()
        else:
            action, _ = self.model.predict(observation)
        noise = np.random.normal(0, self.chosen.action_noise, action.shape)  # noqa: NPY002 - of the model's seed
        return np.clip(action + noise.astype(np.float32), -1, 1)

    def _end_episode(self, rewards: list[float], info: Mapping[str, Any]) -> None:
        history = self.history
        ended = {"ep_rew_mean": sum(rewards), "ep_len_mean": len(rewards), "success_rate": bool(info["is_success"])}
        history.recent_episodes = [*history.recent_episodes, ended][-RECENT_EPISODES:]
        history.episodes += 1
        if history.episodes % self.chosen.log_interval == 0:
            row = {f"rollout/{name}": _mean(each[name] for each in history.recent_episodes) for name in ended}
            row |= {f"train/{name}": _mean(losses) for name, losses in self._losses.items()}
            self._losses.clear()
            self._log(row | {"time/episodes": history.episodes, "train/n_updates": history.gradient_steps})

    def _evaluate(self) -> None:
        """Play the held-out starts without noise."""
        played = [self._play_held_out(number) for number in range(self.chosen.evaluation_episodes)]
        rewards, lengths, successes = ([each[i] for each in played] for i in range(3))
        self.history.evaluations.append(
            {
                "timesteps": self.history.env_steps,
                "results": rewards,
                "ep_lengths": lengths,
                "successes": successes,
            }
        )
        file = io.BytesIO()
        columns = self.history.evaluations[0]
        arrays: Arrays = {name: np.array([each[name] for each in self.history.evaluations]) for name in columns}
        np.savez(file, **arrays)  # type: ignore[arg-type] # NumPy's type forgets that any name may be given
        write_bytes(self.folder / "evaluations.npz", file.getvalue())
        means = {"mean_reward": rewards, "mean_ep_length": lengths, "success_rate": successes}
        self._log({f"eval/{name}": _mean(values) for name, values in means.items()})

    def _play_held_out(self, number: int) -> tuple[float, int, bool]:
        """Play an episode, and return its reward, its length in env steps, and whether it was solved."""
        observation, _ = self.held_out_env.reset(options=self._start(Use.CHOOSE, number))
        rewards: list[float] = []
        while True:
            action, _ = self.model.predict(observation)
            observation, reward, terminated, truncated, info = self.held_out_env.step(action)
            rewards.append(float(reward))
            if terminated or truncated:
                return sum(rewards), len(rewards), bool(info["is_success"])

    def _log(self, row: Mapping[str, float]) -> None:
        """Add a row to `progress.csv` and to the charts."""
        self._count_time()
        history = self.history
        row = {
            "time/total_timesteps": history.env_steps,
            "time/cpu_s": round(history.cpu_s, 1),
            "time/time_elapsed": int(history.elapsed_s),
            "time/fps": int(history.env_steps / max(history.elapsed_s, 1e-3)),
            **row,
        }
        history.log.append(row)
        text = io.StringIO()
        table = csv.DictWriter(text, LOG_COLUMNS, lineterminator="\n")
        table.writeheader()
        table.writerows(history.log)
        write_text(self.folder / "progress.csv", text.getvalue())
        self.charts.add_row(history.env_steps, row)

    def _count_time(self) -> None:
        self.history.cpu_s = self._cpu_s_before + process_time()
        self.history.elapsed_s = self._elapsed_s_before + time()

    def _store_when_due(self, env_steps: int, progress: TrainingProgress) -> None:
        """Store the state between two episodes once the next checkpoint is reached.

        Nothing of the physics has to be stored then: the next episode begins at a start that is known by its number.
        """
        every, reached = self.chosen.checkpoint_env_steps, self.history.env_steps
        if reached // every == self._stored_env_steps // every:
            return
        self._count_time()
        save(self.folder / STATE_FILE, self._state())
        self._stored_env_steps = reached
        self.tell(f"{reached} of {env_steps} env steps{progress.left(reached, env_steps)}")

    def _state(self) -> Arrays:
        random = np.random.get_state(legacy=False)  # noqa: NPY002 - Stable-Baselines3 draws from it
        state = {
            "history": asdict(self.history),
            "random": {**random, "state": {**random["state"], "key": random["state"]["key"].tolist()}},
            "random_of_actions": self.model.action_space.np_random.bit_generator.state,
            "buffer": {"pos": self.model.replay_buffer.pos, "full": self.model.replay_buffer.full},
        }
        networks = io.BytesIO()
        torch.save([part.state_dict() for part in self._learning_parts()], networks)
        return {
            "state": np.array(json.dumps(state)),
            "random_of_torch": torch.get_rng_state().numpy(),
            "networks": np.frombuffer(networks.getvalue(), np.uint8),
            **self._transitions(),
        }

    def _restore(self) -> None:
        try:
            arrays = load(self.folder / STATE_FILE)
        except FileDamaged as error:
            raise FileDamaged(f"{error} The training then begins at 0 env steps, whatever its checkpoints.") from error
        state = json.loads(str(arrays["state"]))
        self.history = TrainingHistory(**state["history"])
        np.random.set_state(state["random"])  # noqa: NPY002
        torch.set_rng_state(torch.from_numpy(arrays["random_of_torch"]))
        self.model.action_space.np_random.bit_generator.state = state["random_of_actions"]
        networks = torch.load(io.BytesIO(arrays["networks"].tobytes()), map_location="cpu", weights_only=True)
        for part, stored in zip(self._learning_parts(), networks, strict=True):
            part.load_state_dict(stored)
        vars(self.model.replay_buffer).update(state["buffer"])
        for name, values in self._transitions().items():
            values[:] = arrays[name]

    def _learning_parts(self) -> tuple[Any, ...]:
        return self.model.policy, self.model.actor.optimizer, self.model.critic.optimizer

    def _transitions(self) -> Arrays:
        """Return views of what the replay buffer holds."""
        buffer = self.model.replay_buffer
        arrays = {name: getattr(buffer, name) for name in ("actions", "rewards", "dones")}
        for name in ("observations", "next_observations"):
            arrays |= {f"{name}/{key}": array for key, array in getattr(buffer, name).items()}
        return {name: array[: buffer.size()] for name, array in arrays.items()}

    def _write_model(self, path: Path) -> None:
        """Write a model as Stable-Baselines3 saves it."""
        self.model.num_timesteps = self.history.env_steps
        file = io.BytesIO()
        self.model.save(file)
        write_bytes(path, file.getvalue())

    def write_submission(self, sensor: Path | None) -> Path:
        """Make a submission of the model, with the sensor that it was trained on, and return its folder."""
        track = self.folder / "submission" / load_track(self.chosen.track).folder
        if sensor is not None:
            shutil.copytree(sensor, track, dirs_exist_ok=True)
        write_text(
            track / "submission.yaml",
            f"track: {self.chosen.track}\ntasks: [{self.task}]\nname: challenge's TD3\nentry_point: policy:Policy\n"
            f"observation_keys: [{', '.join(self.model.actor.network.observed)}]\n",
        )
        shutil.copyfile(Path(__file__).with_name("policy.py"), track / "policy.py")
        shutil.copyfile(self.folder / f"{self.task}.zip", track / f"{self.task}.zip")
        return track.parent


def _mean(values: Iterable[float]) -> float:
    return float(np.mean(list(values)))


CLOUDS_AT_ONCE = 32
"""Sets of points whose numbers, at most 512 of each point, fit into a core's cache."""


class CachedPointNet(PointNet):
    """The encoder of the policy with the same weights, in which a training spends nearly all its time.

    On a CPU its layers go over parts of a batch that fit into a core's cache, as convolutions of width 1, which torch's
    build for CPUs computes faster than products of matrices.
    """

    def forward(self, points: Any) -> Any:
        """Return numbers of shape [..., outputs] from points of shape [..., n, channels]."""
        if points.device.type != "cpu":
            return super().forward(points)
        *sets, count, channels = points.shape
        pictures = points.reshape(-1, 1, count, channels).permute(0, 3, 1, 2)
        parts = pictures.tensor_split(max(1, -(-len(pictures) // CLOUDS_AT_ONCE)))
        largest = torch.cat([self._largest(part) for part in parts])
        return self.whole(largest).unflatten(0, sets)

    def _largest(self, pictures: Any) -> Any:
        """Return the largest of each number over the points, shape [sets, 512], from shape [sets, channels, 1, n]."""
        *layers, last = self.points
        for layer in layers:
            is_linear = isinstance(layer, nn.Linear)
            pictures = _convolve(pictures, layer.weight, layer.bias) if is_linear else functional.relu_(pictures)
        if torch.is_grad_enabled():
            return _LargestOverPoints.apply(pictures, last.weight, last.bias)
        return _convolve(pictures, last.weight, last.bias).amax(dim=(2, 3))


class _LargestOverPoints(torch.autograd.Function):  # type: ignore[misc]
    """A linear layer and the largest of each number over the points.

    Only the point with the largest number has a gradient: at most 512 of all that the layer computes for a set. So the
    sums of the backward pass run over those, not over products of matrices that are nearly all zero.
    """

    @staticmethod
    def forward(ctx: Any, pictures: Any, weight: Any, bias: Any) -> Any:
        """Return numbers of shape [sets, outputs] from points of shape [sets, inputs, 1, n]."""
        largest, indices = _convolve(pictures, weight, bias).flatten(2).max(dim=-1)
        ctx.save_for_backward(pictures, weight, indices)
        return largest

    @staticmethod
    def backward(ctx: Any, d_largest: Any) -> Any:
        """Return the gradients of points, weight and bias."""
        pictures, weight, indices = ctx.saved_tensors
        sets, inputs, _, count = pictures.shape
        points = pictures.permute(0, 2, 3, 1).reshape(-1, inputs)
        first = torch.arange(0, sets * count, count)[:, None]
        d_weight = _weighted_sums((indices + first).t(), points, d_largest.t(), torch.arange(0, indices.numel(), sets))
        indices, outputs = indices.sort(dim=1)
        starts = torch.searchsorted((indices + first).flatten(), torch.arange(sets * count))
        d_points = _weighted_sums(outputs, weight, d_largest.gather(1, outputs), starts)
        return d_points.view(sets, 1, count, inputs).permute(0, 3, 1, 2), d_weight, d_largest.sum(dim=0)


def _weighted_sums(rows: Any, table: Any, factors: Any, starts: Any) -> Any:
    """Return sums of rows of a table, each times its factor; each sum begins at one of the starts."""
    return functional.embedding_bag(rows.flatten(), table, starts, mode="sum", per_sample_weights=factors.flatten())


def _convolve(pictures: Any, weight: Any, bias: Any) -> Any:
    return functional.conv2d(pictures, weight[:, :, None, None], bias)
