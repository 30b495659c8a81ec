"""Re-simulation: recorded actions through the physics again; under `vitac resimulate` and log verification."""

from dataclasses import dataclass
from time import perf_counter

import numpy as np
from numpy.typing import NDArray
from pydantic import JsonValue

from ..tracks import Episode
from .episode import Environment, json_info
from .records import ContactForces, EpisodeOutcome, SampledPicture, Timings
from .traces import ForceTrace, PictureSample


@dataclass(frozen=True, kw_only=True)
class Resimulated:
    """An episode played again.

    `state_hashes` starts with the reset's. `end_step` counts from 1; it and `outcome` are None where nothing ended it.
    `picture` and `forces` are of the env steps up to its end.
    """

    state_hashes: tuple[str, ...]
    infos: tuple[dict[str, JsonValue], ...]
    total_reward: float
    outcome: EpisodeOutcome | None
    end_step: int | None
    picture: SampledPicture | None
    forces: ContactForces | None
    timings: Timings


def resimulate(env: Environment, episode: Episode, actions: NDArray[np.float32]) -> Resimulated:
    """Play all recorded actions, also those after the env step that ends the episode.

    Args:
        env: environment of the task.
        episode: the start.
        actions: raw float32 actions, shape [env steps, action size].

    Returns:
        What happened; the reward is that up to the end of the episode.
    """
    started, physics_s, markers_s = perf_counter(), env.physics_cpu_s, env.marker_cpu_s
    sample, forces = PictureSample(env, episode), ForceTrace()
    env.reset(options=episode.options)
    state_hashes, infos = [sample.look(env_step=0)], []
    total_reward, outcome, end_step = 0.0, None, None
    for step, action in enumerate(actions, start=1):
        _, reward, terminated, truncated, info = env.step(action)
        state_hashes.append(sample.look(step) if end_step is None else env.state_hash())
        infos.append(json_info(info))
        if end_step is None:
            total_reward += float(reward)
            forces.add(info)
            if terminated or truncated:
                outcome, end_step = EpisodeOutcome(info["end_reason"]), step
    return Resimulated(
        state_hashes=tuple(state_hashes),
        infos=tuple(infos),
        total_reward=total_reward,
        outcome=outcome,
        end_step=end_step,
        picture=sample.picture,
        forces=forces.figures(),
        timings=Timings(
            physics_s=env.physics_cpu_s - physics_s,
            markers_s=env.marker_cpu_s - markers_s,
            wall_s=perf_counter() - started,
        ),
    )
