"""Plays a fixed trajectory of an environment and digests every bit of it; run in this and in other processes.

As a script it prints the digests of all environments, and what the surroundings really were, as JSON.
"""

import hashlib
import json
import os
import sys
from typing import Any

import gymnasium
import numpy as np
import vitac.envs
from visible_scenes import STARTS, fusion_scene
from vitac.envs.vision.look import colour_picture
from vitac.envs.vision.stereo.camera import depth_of_pair, draw_noise_keys, infrared_pair


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


def picture_digest(seed: int) -> str:
    """SHA-256 over all pictures of a scene with bodies in front of each other."""
    scene = fusion_scene(STARTS[seed])
    view, keys = scene.view(), draw_noise_keys(np.random.default_rng(seed))
    pair = infrared_pair(scene.surfaces, scene.vertices_m, pose=scene.pose, colour_view=view, noise_keys=keys)
    colours = colour_picture(view, scene.surfaces, scene.vertices_m)
    digest = hashlib.sha256(view.depth_m.tobytes() + colours.tobytes())
    digest.update(pair.left.tobytes() + pair.right.tobytes() + depth_of_pair(pair, view).tobytes())
    return digest.hexdigest()


def digests() -> dict[str, str]:
    """Digest of a trajectory of each environment, and of pictures."""
    played = {env_id: trajectory_digest(env_id, 5, 2) for env_id in sorted(vitac.envs.ENVIRONMENTS)}
    return {**played, "pictures": picture_digest(3)}


def numpy_simd() -> list[str]:
    """Sets of vector instructions beyond its baseline that NumPy uses in this process."""
    from numpy._core._multiarray_umath import __cpu_dispatch__, __cpu_features__  # type: ignore[import-not-found]

    return [name for name in __cpu_dispatch__ if __cpu_features__[name]]


def played() -> dict[str, Any]:
    """All digests, and what the surroundings really were."""
    import numba

    surroundings = {
        "folder": os.getcwd(),  # noqa: PTH109 - as the process sees it
        "hash_of_a_word": hash("word"),
        "numpy_simd": numpy_simd(),
        "compiled_for": numba.config.CPU_NAME,  # type: ignore[attr-defined]
    }
    return {"digests": digests(), "surroundings": surroundings}


if __name__ == "__main__":
    sys.stdout.write(json.dumps(played()))
