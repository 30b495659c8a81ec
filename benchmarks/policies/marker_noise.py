"""Measures what the noise of the markers takes: how well offsets can be estimated, and how many pegs go in, without it.

PYTHONPATH=benchmarks python benchmarks/policies/marker_noise.py [--episodes 1200] [--starts 300] [--json FILE]

The same random motions from the same fresh starts are played with the challenge's noise (0.5 pixels) and with none. Two
thirds of the episodes fit a belief for each, as training does; its error is measured on the others. Then the trained
policy, which was taught with the noise, plays fresh starts with both.
"""

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from policies.baselines import EXAMPLES, load_policy
from trained_policy import figures, fresh_starts
from vitac.envs.tactile.markers import MarkerSettings
from vitac.evaluator.episodes import episode
from vitac.evaluator.tracks import load_track
from vitac.training.collection import random_actor
from vitac.training.episodes import TASK, Episodes, make_environment, play
from vitac.training.learning.student import OFFSET, fit_belief, student_inputs
from vitac.training.streams import Use, stream
from vitac.training.submission.policy import belief_inputs

NOISES_PX = (MarkerSettings().noise_px, 0.0)
LEAST_EPISODES = 30
"""With fewer episodes at an env step, its error is not printed."""


def main() -> None:
    """Play, fit, and print what was found."""
    parser = argparse.ArgumentParser(description="what the noise of the markers takes")
    parser.add_argument("--episodes", type=int, default=1200, help="of random motions")
    parser.add_argument("--starts", type=int, default=300, help="of the trained policy")
    parser.add_argument("--seed", type=int, default=1, help="of the stream of fresh starts")
    parser.add_argument("--json", type=Path, help="write the figures to this file")
    chosen = parser.parse_args()
    found = {f"{noise_px:g} px": measure_noise(noise_px, chosen) for noise_px in NOISES_PX}
    print(json.dumps(found, indent=1))
    if chosen.json:
        chosen.json.write_text(json.dumps(found, indent=1) + "\n")


def measure_noise(noise_px: float, chosen: argparse.Namespace) -> dict[str, Any]:
    """Return the errors of beliefs, and what the trained policy solves, with this noise."""
    markers = MarkerSettings(noise_px=noise_px)
    policy = load_policy(EXAMPLES / "peg_insertion_trained")
    env: Any = episode.make_environment(load_track("track_1").tasks[TASK], settings={"markers": markers})
    solved = figures(env, policy, fresh_starts(chosen.seed, chosen.starts))
    seed, fitted = stream(chosen.seed, Use.REPORT), 2 * chosen.episodes // 3
    parts = (range(fitted), range(fitted, chosen.episodes))
    taught, fresh = (play(make_environment(markers=markers), random_actor, seed, numbers) for numbers in parts)
    return {"solved": solved, "beliefs": errors(policy.weights, taught, fresh)}


def errors(weights: dict[str, NDArray[Any]], taught: Episodes, fresh: Episodes) -> list[dict[str, Any]]:
    """Return by env steps before the look the root mean square errors of a belief, and the spread of the truth.

    Args:
        weights: of the student's networks, whose first layers the belief looks at.
        taught: episodes that the belief is fitted to.
        fresh: others.
    """
    believed = belief_inputs(weights, student_inputs(fresh)[fresh.observations]) @ fit_belief(weights, taught)
    true = fresh.truths[fresh.observations, OFFSET]
    rows = []
    for step in range(int(fresh.step.max()) + 1):
        here = fresh.step == step
        if here.sum() >= LEAST_EPISODES:
            error = np.sqrt(((believed[here] - true[here]) ** 2).mean(axis=0))
            spread = true[here].std(axis=0)
            rows.append(
                {"env_steps": step, "looks": int(here.sum()), "error": error.tolist(), "spread": spread.tolist()}
            )
    return rows


if __name__ == "__main__":
    main()
