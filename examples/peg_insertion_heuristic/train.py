"""Fits the weights of `Track_1`: two ridge regressions of the true offset on the marker flow.

Usage: python examples/peg_insertion_heuristic/train.py [--contact-model challenge-2025] [--out FOLDER]

The first uses the first contact. The second corrects it by the marker flow after the first motion, in episodes that use
the first. It takes a few minutes on one core. FOLDER is a copy of `Track_1` to fit instead.
Its starts are random and blocked: none is in the public list, and benchmarks/policies/example.py uses others.
"""

import argparse
import json
import sys
from pathlib import Path

import gymnasium
import numpy as np
import vitac.envs  # noqa: F401 - registers the environment

options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
options.add_argument("--contact-model", default="challenge-2025")
options.add_argument("--out", type=Path, default=Path(__file__).parent / "Track_1")
chosen = options.parse_args(None if __name__ == "__main__" else [])

sys.path.insert(0, str(chosen.out))
from policy import Policy  # noqa: E402 - of that folder

WEIGHTS = chosen.out / "weights.json"
TRAINING_SEEDS = (1, 6)
STARTS = (2500, 580)
GAINS = (1.5, 1.0)  # A fit shrinks uncertain offsets to zero, but a peg that moves too little stays blocked.
RIDGE = 40.0
MIN_EXPLAINED = 0.1  # of the variance; below that a component is not predicted


def main() -> None:
    """Collect data for and fit one regression after the other."""
    regressions: list[dict[str, list]] = []
    for step in (0, 1):
        WEIGHTS.write_text(json.dumps(regressions) + "\n")
        weights, explained = fit(*play(step), GAINS[step])
        print(f"variance of x, y, theta that regression {step} explains in held-out starts:", np.round(explained, 2))
        regressions.append(weights)
    WEIGHTS.write_text(json.dumps(regressions) + "\n")


def play(step: int) -> tuple[np.ndarray, np.ndarray]:
    """Return inputs and residual offsets [mm, mm, degrees] at an env step of random episodes."""
    env = gymnasium.make(
        "ViTac/PegInsertion-v1", privileged=True, disable_env_checker=True, contact_model=chosen.contact_model
    ).unwrapped
    policy = Policy()
    policy.regressions.append(ZERO_REGRESSION)
    inputs, residuals = [], []
    for number in range(STARTS[step]):
        observation, _ = env.reset(options={"rng_seed": (TRAINING_SEEDS[step], number)})
        policy.reset("peg-insertion")
        ended = False
        while policy.env_step < step and not ended:
            observation, _, terminated, truncated, _ = env.step(policy.act(observation))
            ended = terminated or truncated
        if not ended:
            policy.act(observation)
            inputs.append(policy.inputs)
            residuals.append(observation["gt_offset"] - policy.start - observation["relative_motion"][:3])
        print(f"\repisode {number + 1} of {STARTS[step]}", end="", file=sys.stderr)
    print(file=sys.stderr)
    return np.array(inputs), np.array(residuals)


def fit(inputs: np.ndarray, residuals: np.ndarray, gain: float) -> tuple[dict[str, list], np.ndarray]:
    """Return the weights, and how much of the variance of x, y and theta they explain in the first, held-out fifth."""
    held_out = len(inputs) // 5
    mean, scale = inputs.mean(axis=0), inputs.std(axis=0) + 1e-3  # Features that always saturate have no spread.
    normal = (inputs - mean) / scale
    gram = normal[held_out:].T @ normal[held_out:] + RIDGE * np.eye(normal.shape[1])
    weights = np.linalg.solve(gram, normal[held_out:].T @ residuals[held_out:])
    errors = normal[:held_out] @ weights - residuals[:held_out]
    explained = 1 - (errors**2).mean(axis=0) / (residuals[:held_out] ** 2).mean(axis=0)
    weights[:, explained < MIN_EXPLAINED] = 0  # Not predicted.
    names = {"mean": mean, "scale": scale, "weights": gain * weights}
    return {name: np.round(value, 4).tolist() for name, value in names.items()}, explained


ZERO_REGRESSION = {"mean": np.zeros(1), "scale": np.ones(1), "weights": np.zeros((1, 3))}
"""Predicts zero, so that the policy collects inputs at the env step whose regression is fitted."""


if __name__ == "__main__":
    main()
