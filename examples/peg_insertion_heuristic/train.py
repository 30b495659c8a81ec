"""Fits `Track_1/weights.json`: two ridge regressions of the true offset on what is felt.

The first reads the first touch. The second corrects it by how the gels answer to the first motion, in episodes that are
played with the first. Run it as `python examples/peg_insertion_heuristic/train.py`; it takes some minutes on one core.
Its starts are random and blocked: none is in the public list, and benchmarks/example_policy.py uses others.
"""

import json
import sys
from pathlib import Path

import gymnasium
import numpy as np
import vitac.envs  # noqa: F401 - registers the environment

sys.path.insert(0, str(Path(__file__).parent / "Track_1"))
from policy import Policy

WEIGHTS = Path(__file__).parent / "Track_1" / "weights.json"
TRAINING_SEEDS = (1, 6)
STARTS = (2500, 580)
BOLDNESS = (1.5, 1.0)  # A fit takes what it cannot tell for zero; but a peg that is moved too little stays blocked.
RIDGE = 40.0
TELLING = 0.1  # of the variance


def main() -> None:
    """Plays and fits, one reading after the other."""
    readings: list[dict[str, list]] = []
    for step in (0, 1):
        WEIGHTS.write_text(json.dumps(readings) + "\n")
        weights, explained = fit(*play(step), BOLDNESS[step])
        print(f"reading {step} explains of x, y, theta in held-out starts:", np.round(explained, 2))
        readings.append(weights)
    WEIGHTS.write_text(json.dumps(readings) + "\n")


def play(step: int) -> tuple[np.ndarray, np.ndarray]:
    """Return what is felt at an env step and by how much the offset is then misjudged [mm, mm, degrees]."""
    env = gymnasium.make("ViTac/PegInsertion-v1", privileged=True, disable_env_checker=True).unwrapped
    policy = Policy()
    policy.readings.append(BLANK)
    felt, misjudged = [], []
    for number in range(STARTS[step]):
        observation, _ = env.reset(options={"rng_seed": (TRAINING_SEEDS[step], number)})
        policy.reset("peg-insertion")
        ended = False
        while policy.env_step < step and not ended:
            observation, _, terminated, truncated, _ = env.step(policy.act(observation))
            ended = terminated or truncated
        if not ended:
            policy.act(observation)
            felt.append(policy.felt)
            misjudged.append(observation["gt_offset"] - policy.start - observation["relative_motion"][:3])
        print(f"\rplayed {number + 1} of {STARTS[step]}", end="", file=sys.stderr)
    print(file=sys.stderr)
    return np.array(felt), np.array(misjudged)


def fit(felt: np.ndarray, misjudged: np.ndarray, boldness: float) -> tuple[dict[str, list], np.ndarray]:
    """Return the weights, and how much of the variance of x, y and theta they explain in the first, held-out fifth."""
    held_out = len(felt) // 5
    mean, scale = felt.mean(axis=0), felt.std(axis=0) + 1e-3  # What always saturates has no spread.
    normal = (felt - mean) / scale
    gram = normal[held_out:].T @ normal[held_out:] + RIDGE * np.eye(normal.shape[1])
    weights = np.linalg.solve(gram, normal[held_out:].T @ misjudged[held_out:])
    errors = normal[:held_out] @ weights - misjudged[:held_out]
    explained = 1 - (errors**2).mean(axis=0) / (misjudged[:held_out] ** 2).mean(axis=0)
    weights[:, explained < TELLING] = 0  # What cannot be told is left alone.
    names = {"mean": mean, "scale": scale, "weights": boldness * weights}
    return {name: np.round(value, 4).tolist() for name, value in names.items()}, explained


BLANK = {"mean": np.zeros(1), "scale": np.ones(1), "weights": np.zeros((1, 3))}
"""A reading that tells nothing, so that the policy feels at the env step whose reading is fitted."""


if __name__ == "__main__":
    main()
