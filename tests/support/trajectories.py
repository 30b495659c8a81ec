"""Plays a fixed trajectory of an environment and digests every bit of it; run in this and in other processes."""

import hashlib
from typing import Any

import gymnasium
import numpy as np
import vitac.envs  # noqa: F401 - registers the ids


def trajectory_digest(env_id: str, seed: int, env_steps: int) -> str:
    """SHA-256 over states, observations, rewards and ends of a random trajectory."""
    env: Any = gymnasium.make(env_id, disable_env_checker=True).unwrapped
    actions = np.random.default_rng(seed).uniform(-1, 1, (env_steps, *env.action_space.shape)).astype(np.float32)
    digest = hashlib.sha256()

    def add(observation: dict[str, np.ndarray], *others: object) -> None:
        digest.update(env.state_hash().encode() + repr(others).encode())
        for key in sorted(observation):
            digest.update(observation[key].tobytes())

    observation, _ = env.reset(seed=seed)
    add(observation)
    for action in actions:
        observation, reward, terminated, truncated, info = env.step(action)
        add(observation, reward, terminated, truncated, info["end_reason"], info["surface_diff_m"].tolist())
    return digest.hexdigest()
