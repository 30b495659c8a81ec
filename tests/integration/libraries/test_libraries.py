"""Each row of the table in docs/libraries.md: a library of others trains, collects or plays in our environments.

They are in the extra `compat`, which the suite's own set-up has not: `.ci/run` runs this file where they can be had.
"""

import re
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.wrappers import FlattenObservation
from vitac.envs.tasks.insertion.env import InsertionGoal
from vitac.envs.tasks.making import NumericInfos

pytestmark = pytest.mark.filterwarnings("default")  # theirs are not our errors

PEG = "ViTac/PegInsertion-v1"
make = partial(gymnasium.make, PEG, max_steps=2)
make_vec = partial(gymnasium.make_vec, PEG, 2, max_steps=2)


def library(name: str) -> Any:
    return pytest.importorskip(name, reason=f"{name} is not installed: its row of docs/libraries.md was not tried")


def flat() -> gymnasium.Env[Any, Any]:
    return FlattenObservation(NumericInfos(make()))


def test_stable_baselines3() -> None:
    sb3 = library("stable_baselines3")
    from stable_baselines3.common.env_util import make_vec_env

    env = make_vec_env(PEG, 2, env_kwargs={"max_steps": 2})
    learner = sb3.PPO("MultiInputPolicy", env, n_steps=4, batch_size=8, n_epochs=1, device="cpu").learn(8)
    assert learner.num_timesteps == 8


def test_stable_baselines3_with_hindsight() -> None:
    sb3 = library("stable_baselines3")
    from stable_baselines3.common.env_checker import check_env

    env = InsertionGoal(make())
    check_env(env)
    buffer = {"n_sampled_goal": 4, "copy_info_dict": True}
    small = {"learning_starts": 4, "batch_size": 8, "policy_kwargs": {"net_arch": [16]}, "device": "cpu"}
    learner = sb3.SAC(
        "MultiInputPolicy", env, replay_buffer_class=sb3.HerReplayBuffer, replay_buffer_kwargs=buffer, **small
    ).learn(8)
    assert learner.replay_buffer.size() == 8
    assert learner._n_updates > 0


def test_torchrl() -> None:
    library("torchrl")
    from torchrl.envs import GymEnv, check_env_specs

    env = GymEnv(PEG, max_steps=2)
    check_env_specs(env)
    env.set_seed(3)
    played = env.rollout(4, break_when_any_done=False)
    assert played["next", "done"].any()
    assert played["marker_flow"].shape == (4, 2, 2, 128, 2)


def test_torchrl_vector() -> None:
    library("torchrl")
    from torchrl.envs import GymWrapper

    env = GymWrapper(make_vec(autoreset_mode="SameStep", env_wrappers=(NumericInfos, FlattenObservation)))
    played = env.rollout(4, break_when_any_done=False)
    env.close()
    ends = played["next", "done"].squeeze(-1)
    assert ends[:, :-1].any()
    assert (played["next", "observation"][..., 0] != 0).all()  # `relative_motion`: also where an episode ends
    assert (played["observation"][:, 1:, 0][ends[:, :-1]] == 0).all()  # and 0 after the reset in the same env step


def test_tianshou() -> None:
    library("tianshou")
    from tianshou.algorithm import Reinforce
    from tianshou.algorithm.modelfree.reinforce import ProbabilisticActorPolicy
    from tianshou.algorithm.optim import AdamOptimizerFactory
    from tianshou.data import Collector, VectorReplayBuffer
    from tianshou.env import DummyVectorEnv
    from tianshou.trainer import OnPolicyTrainerParams
    from tianshou.utils.net.common import Net
    from tianshou.utils.net.continuous import ContinuousActorProbabilistic
    from torch.distributions import Independent, Normal

    envs = DummyVectorEnv([flat, flat])
    (numbers,), (actions,) = flat().observation_space.shape, flat().action_space.shape  # type: ignore[misc]
    policy = ProbabilisticActorPolicy(
        actor=ContinuousActorProbabilistic(
            preprocess_net=Net(state_shape=numbers, hidden_sizes=(16,)), action_shape=(actions,), unbounded=True
        ),
        dist_fn=lambda loc_scale: Independent(Normal(*loc_scale), 1),
        action_space=flat().action_space,
    )
    learner = Reinforce(policy=policy, optim=AdamOptimizerFactory(lr=1e-3))
    steps = {"epoch_num_steps": 8, "collection_step_num_env_steps": 8, "max_epochs": 1, "batch_size": 8}
    found = learner.run_training(
        OnPolicyTrainerParams(
            training_collector=Collector(learner, envs, VectorReplayBuffer(20, 2)),
            show_progress=False,
            verbose=False,
            **steps,
        )
    )
    assert found.update_step == 1


def test_skrl() -> None:
    library("skrl")
    import torch
    from skrl.agents.torch.ppo import PPO, PPO_CFG
    from skrl.envs.wrappers.torch import wrap_env
    from skrl.memories.torch import RandomMemory
    from skrl.models.torch import DeterministicMixin, GaussianMixin, Model
    from skrl.trainers.torch import SequentialTrainer

    env = wrap_env(make_vec(), verbose=False)
    spaces = {"observation_space": env.observation_space, "action_space": env.action_space, "device": "cpu"}
    numbers = gymnasium.spaces.flatdim(env.observation_space)

    class Actor(GaussianMixin, Model):  # type: ignore[misc]
        def __init__(self) -> None:
            Model.__init__(self, **spaces)
            GaussianMixin.__init__(self)
            self.layer = torch.nn.Linear(numbers, 3)
            self.spread = torch.nn.Parameter(torch.zeros(3))

        def compute(self, inputs: dict[str, Any], role: str) -> Any:
            return self.layer(inputs["observations"]), {"log_std": self.spread}

    class Critic(DeterministicMixin, Model):  # type: ignore[misc]
        def __init__(self) -> None:
            Model.__init__(self, **spaces)
            DeterministicMixin.__init__(self)
            self.layer = torch.nn.Linear(numbers, 1)

        def compute(self, inputs: dict[str, Any], role: str) -> Any:
            return self.layer(inputs["observations"]), {}

    models: dict[str, Any] = {"policy": Actor(), "value": Critic()}
    before = [values.clone() for values in models["policy"].parameters()]
    config = PPO_CFG(rollouts=4, learning_epochs=1, mini_batches=1)
    config.experiment.write_interval = config.experiment.checkpoint_interval = 0
    memory = RandomMemory(memory_size=4, num_envs=2, device="cpu")
    agent = PPO(models=models, memory=memory, cfg=config, **spaces)
    quiet = {"timesteps": 4, "disable_progressbar": True, "close_environment_at_exit": False}
    SequentialTrainer(env=env, agents=agent, cfg=quiet).train()
    env.close()
    assert any((one != other).any() for one, other in zip(before, models["policy"].parameters(), strict=True))


def test_minari(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    minari = library("minari")
    library("jax")
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    collected = minari.DataCollector(NumericInfos(make()), record_infos=True)
    ends = []
    for seed in range(3):
        collected.reset(seed=seed)
        ended = False
        while not ended:
            *_, terminated, truncated, info = collected.step(collected.action_space.sample())
            ended = terminated or truncated
        ends.append(info["end_reason"])
    collected.create_dataset("vitac/peg-v0", eval_env=make().spec)
    stored = minari.load_dataset("vitac/peg-v0")
    assert [episode.infos["end_reason"][-1] for episode in stored] == ends
    assert {episode.infos["peg_relative_z_mm"].shape[1:] for episode in stored} == {(8,)}
    again = stored.recover_environment()
    observation, _ = again.reset(seed=0)
    np.testing.assert_array_equal(observation["marker_flow"], stored[0].observations["marker_flow"][0])


def test_cleanrl() -> None:
    """The loop of CleanRL's PPO for continuous actions: Gaussian actions, returns from the infos, one update."""
    torch = library("torch")
    envs = make_vec(env_wrappers=(FlattenObservation, gymnasium.wrappers.RecordEpisodeStatistics))
    numbers, actions = map(gymnasium.spaces.flatdim, (envs.single_observation_space, envs.single_action_space))
    actor, critic = torch.nn.Linear(numbers, actions), torch.nn.Linear(numbers, 1)
    optimizer = torch.optim.Adam([*actor.parameters(), *critic.parameters()], lr=1e-3)
    observed, _ = envs.reset(seed=1)
    values, log_probabilities, rewards, ends, returns = [], [], [], 0, []
    for _ in range(6):
        seen = torch.as_tensor(observed)
        spread = torch.distributions.Normal(actor(seen), 1.0)
        action = spread.sample()
        values.append(critic(seen).ravel())
        log_probabilities.append(spread.log_prob(action).sum(1))
        observed, reward, terminated, truncated, info = envs.step(action.numpy())
        ends += int((terminated | truncated).sum())
        rewards.append(reward)
        if "episode" in info:
            returns += info["episode"]["r"][info["_episode"]].tolist()
    envs.close()
    gained = torch.as_tensor(np.array(rewards)) - torch.stack(values)
    loss = -(torch.stack(log_probabilities) * gained.detach()).mean() + gained.pow(2).mean()
    optimizer.zero_grad()
    loss.backward()
    optimizer.step()
    assert len(returns) == ends >= 4
    assert torch.isfinite(loss)


def test_rllib() -> None:
    """Run by hand in an environment of RLlib's pins: `pip install "ray[rllib]" torch pytest .`."""
    if not gymnasium.__version__.startswith("1.2."):
        pytest.skip("RLlib pins Gymnasium 1.2.2: its row of docs/libraries.md was not tried")
    ray = library("ray.rllib") and library("ray")
    from ray.rllib.algorithms.ppo import PPOConfig
    from ray.tune.registry import register_env

    register_env("peg", lambda _: flat())
    ray.init(num_cpus=1, include_dashboard=False, log_to_driver=False)
    try:
        config = PPOConfig().environment("peg").learners(num_learners=0)
        config = config.env_runners(num_env_runners=0, rollout_fragment_length=8)
        config = config.training(train_batch_size_per_learner=8, minibatch_size=8, num_epochs=1)
        learner = config.build_algo()
        assert learner.train()["env_runners"]["num_env_steps_sampled"] == 8
        learner.stop()
    finally:
        ray.shutdown()


def test_every_row_of_the_table_has_its_test(repository: Path) -> None:
    table = (repository / "docs" / "libraries.md").read_text()
    rows = re.findall(r"^\|.*\| `(test_\w+)` \|$", table, re.MULTILINE)
    *ours, lerobot, server = rows
    assert [*ours, "test_every_row_of_the_table_has_its_test"] == [name for name in globals() if name[:5] == "test_"]
    other = repository / "tests" / "unit" / "training" / "demonstrations" / "lerobot" / "test_writing.py"
    assert f"def {lerobot}(" in other.read_text()
    remote = repository / "tests" / "integration" / "remote" / "test_policy_servers.py"
    assert f"def {server}(" in remote.read_text()
