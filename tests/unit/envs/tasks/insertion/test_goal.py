"""The goal interface gives the task's own reward for its own goal, and that of a reached goal for a replaced one."""

from typing import Any

import gymnasium
import numpy as np
import pytest
import vitac.envs
from vitac.envs.tasks.insertion.env import InsertionGoal, NoGoal

PEG, LOCK, FUSION = "ViTac/PegInsertion-v1", "ViTac/LockOpening-v1", "ViTac/FusionInsertion-v1"
assert vitac.envs.ENVIRONMENTS


def played(env: Any, seed: int) -> list[tuple[Any, float, Any]]:
    """Observation, reward and info of each env step of an episode of random actions."""
    env.reset(seed=seed)
    random, steps, ended = np.random.default_rng(seed), [], False
    while not ended:
        observation, reward, terminated, truncated, info = env.step(random.uniform(-1, 1, env.action_space.shape))
        steps.append((observation, reward, info))
        ended = terminated or truncated
    return steps


@pytest.mark.parametrize("env_id", [PEG, FUSION])
def test_reward_of_the_own_goal_is_the_environments_own_to_the_bit(env_id: str) -> None:
    keys = ("marker_flow", "relative_motion")
    env = InsertionGoal(gymnasium.make(env_id, disable_env_checker=True, max_steps=6, observation_keys=keys))
    steps = [step for seed in range(3) for step in played(env, seed)]
    observations, rewards, infos = zip(*steps, strict=True)
    achieved, desired = (np.array([seen[key] for seen in observations]) for key in ("achieved_goal", "desired_goal"))
    assert env.observation_space.contains(observations[0])
    assert env.compute_reward(achieved, desired, infos).tolist() == list(rewards)
    assert [env.compute_reward(*each) for each in zip(achieved, desired, infos, strict=True)] == list(rewards)


def test_replaced_goal_is_reached_where_the_offset_from_it_is_small() -> None:
    env = InsertionGoal(gymnasium.make(PEG, disable_env_checker=True), tolerance=0.5)
    observation, _, info = played(env, 1)[0]
    achieved, before = observation["achieved_goal"], info["achieved_goal_before"]
    moved = float(np.linalg.norm(achieved - before))
    assert env.compute_reward(achieved, achieved, info) == pytest.approx(moved - 1.0 + 10.0)
    beside = achieved + np.array([0.6, 0.0, 0.0])
    closer = np.linalg.norm(before - beside) - 0.6
    assert env.compute_reward(achieved, beside, info) == pytest.approx(closer - 1.0)
    failed = info | {"tactile_movement_too_large": True}
    assert env.compute_reward(achieved, achieved, failed) == pytest.approx(moved - 1.0 - 2.0 * 7 + 1.0)


def test_missing_info_and_task_without_offset_are_named() -> None:
    env = InsertionGoal(gymnasium.make(PEG, disable_env_checker=True))
    with pytest.raises(NoGoal, match="copy_info_dict=True"):
        env.compute_reward(np.ones((2, 3)), np.ones((2, 3)), [{}, {}])
    with pytest.raises(NoGoal, match=f"offset from a hole, got {LOCK}"):
        InsertionGoal(gymnasium.make(LOCK, disable_env_checker=True))
