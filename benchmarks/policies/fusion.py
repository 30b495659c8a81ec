"""Plays the example policy of Track 2 from random starts: how often it succeeds, how well it sees, how long it takes.

Usage: python benchmarks/policies/fusion.py [--starts N] [--seed N] [--depth-mode stereo|gt] [--hole-mm MM]
    [--camera-mm MM] [--camera-deg DEG]

The policy was made with seeds below 1000. `--hole-mm` has it believe that the holes lie elsewhere, by so much in any
direction, so that the search by touch can be seen at work. `--camera-mm` and `--camera-deg` displace the camera by up
to so much along each axis, and turn it by up to so much, which the policy does not know.
"""

import argparse
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import import_module
from math import cos, pi, radians, sin
from pathlib import Path
from statistics import fmean
from time import process_time
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from vitac.envs.tasks.fusion_insertion.env import FusionInsertionEnv
from vitac.evaluator.scoring.score import rate

EXAMPLE = Path(__file__).parents[2] / "examples" / "track_2_fusion" / "Track_2"
KEYS = ("relative_motion", "rgb_picture", "depth_picture", "marker_flow")
# The peg's lower end is as high as the rim at this offset z [mm].
RIM_OFFSET_MM = 9.5


@dataclass(frozen=True, kw_only=True, eq=False)
class Played:
    """What one episode showed.

    Attributes:
        env_steps: its length.
        success: whether it ended by success.
        tries: how often the peg met the rim where the policy searched for the hole.
        errors: estimates of the start less the true one [mm, mm, degree, mm]: from depth alone (y and z), from the
            outlines at the first look, and from those of all looks; shape [3, 4].
        policy_s: CPU time of the policy [s].
    """

    env_steps: int
    success: bool
    tries: int
    errors: NDArray[np.float64]
    policy_s: float


def main() -> None:
    """Play and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--starts", type=int, default=150)
    parser.add_argument("--seed", type=int, default=1000)
    parser.add_argument("--depth-mode", choices=("stereo", "gt"), default="stereo")
    parser.add_argument("--hole-mm", type=float, default=0.0)
    parser.add_argument("--camera-mm", type=float, default=0.0)
    parser.add_argument("--camera-deg", type=float, default=0.0)
    arguments = parser.parse_args()
    sys.path.insert(0, str(EXAMPLE))
    modules = SimpleNamespace(**{name: import_module(name) for name in ("policy", "picture")})
    env = FusionInsertionEnv(
        depth_mode=arguments.depth_mode,
        observation_keys=KEYS,
        random_camera_offset_m=arguments.camera_mm * 1e-3,
        random_camera_turn_rad=radians(arguments.camera_deg),
    )
    holes = dict(modules.policy.HOLES)
    episodes = []
    for number in range(arguments.starts):
        options = {"rng_seed": (arguments.seed, number)}
        angle = np.random.default_rng([arguments.seed, number]).uniform(0, 2 * pi)
        displaced = arguments.hole_mm * np.array([cos(angle), sin(angle)])
        modules.policy.HOLES.update({shape: middle + displaced for shape, middle in holes.items()})
        episodes.append(play(env, modules, options))
    report(episodes)


def play(env: FusionInsertionEnv, modules: SimpleNamespace, options: Mapping[str, Any]) -> Played:
    """Play one episode."""
    first, info = env.reset(options=options)
    start = info["gt_offset_mm_deg"] + np.array([0.0, env.task_scene.target.y_mm, 0.0, -RIM_OFFSET_MM])
    y, z = modules.picture.Picture(first["rgb_picture"], first["depth_picture"]).rough_base_place()
    policy = modules.policy.Policy()
    policy.reset("fusion-insertion")
    observation, spent_s = first, 0.0
    while info["end_reason"] is None:
        before_s = process_time()
        action = policy.act(observation)
        spent_s += process_time() - before_s
        observation, *_, info = env.step(action)
    estimates = [[np.nan, y, np.nan, z], policy.starts[0], np.median(policy.starts, axis=0)]
    return Played(
        env_steps=info["steps"],
        success=info["is_success"],
        tries=policy.tries,
        errors=np.array(estimates) - start,
        policy_s=spent_s,
    )


def report(episodes: list[Played]) -> None:
    """Print the figures of all episodes."""
    solved = [episode.env_steps for episode in episodes if episode.success]
    result = rate(len(solved), len(episodes))
    steps = f", {fmean(solved):.2f} env steps" if solved else ""
    low, high = result.interval.low, result.interval.high
    print(f"success {result.successes}/{result.episodes} = {result.success_rate:.1%} [{low:.1%}, {high:.1%}]{steps}")
    searched = sum(episode.tries > 0 for episode in episodes)
    print(f"met the rim in {searched} episodes")
    errors = np.abs([episode.errors for episode in episodes])
    print("error of the start, median and largest: x [mm], y [mm], theta [degree], z [mm]")
    for source, given in zip(("depth alone", "first look", "all looks"), np.moveaxis(errors, 1, 0), strict=True):
        figures = [f"{np.median(column):7.3f} {column.max():6.3f}" for column in given.T]
        print(f"  {source:11}", *(figure.replace("nan", "  -") for figure in figures))
    policy_ms = 1e3 * sum(episode.policy_s for episode in episodes) / sum(episode.env_steps for episode in episodes)
    print(f"policy: {policy_ms:.2f} ms of CPU time per env step")


if __name__ == "__main__":
    main()
