"""Plays grasps of random starts, and prints the weights of `Assembly/policy.py`: ridge regression of the truth.

Usage: python examples/assembly_scripted/fit.py [--grasps N] [--seed SEED]
"""

import argparse
import sys
from pathlib import Path

import gymnasium
import numpy as np
import vitac.envs  # noqa: F401 - registers the environments

sys.path.insert(0, str(Path(__file__).parent / "Assembly"))
from policy import Policy, features

RIDGE = 0.01


def fit(seen, truth):
    """Return the weights of features, shape [n, 14], and a constant, that give the truth, shape [n]."""
    middle, spread = seen.mean(axis=0), seen.std(axis=0)
    inputs = np.column_stack([(seen - middle) / spread, np.ones(len(seen))])
    matrix = inputs.T @ inputs + RIDGE * len(seen) * np.eye(inputs.shape[1])
    weights = np.linalg.solve(matrix, inputs.T @ truth)
    slopes = weights[:-1] / spread
    return np.append(slopes, weights[-1] - slopes @ middle)


def main():
    """Play, fit and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--grasps", type=int, default=300)
    parser.add_argument("--seed", type=int, default=77)
    arguments = parser.parse_args()
    env = gymnasium.make("ViTac/Assembly-v1", draws={"gel_friction": (0.6, 1.2)})
    seen, truth = [], []
    for number in range(arguments.grasps):
        observation, info = env.reset(options={"rng_seed": (arguments.seed, number)})
        policy = Policy()
        policy.reset("assembly")
        while True:
            action = policy.act(observation)
            if policy.held is not None:
                break
            observation, _, _, _, info = env.step(action)
        seen.append(features(observation["marker_flow"]))
        x_mm, _, _, theta_deg = info["offset_mm_deg"] - info["relative_motion_mm_deg"]
        truth.append((x_mm + 26.0, theta_deg))
    seen, truth = np.array(seen), np.array(truth)
    weights = np.array([fit(seen[:, which], truth[:, which]) for which in range(2)])
    print(np.array2string(weights, precision=3, separator=", ", max_line_width=110, suppress_small=True))


if __name__ == "__main__":
    main()
