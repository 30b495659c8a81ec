"""Does the example policy beat doing nothing and doing anything? On 270 random blocked starts outside the public list.

Run it as `python benchmarks/example_policy.py [--json FILE]`.
"""

import argparse
import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import vitac.envs  # noqa: F401 - registers the environment
from numpy.typing import NDArray
from vitac.evaluator.scoring import Rate, rate

sys.path.insert(0, str(Path(__file__).parents[1] / "examples" / "peg_insertion_heuristic" / "Track_1"))
from policy import Policy

STARTS = 270
SEED = 2
Act = Callable[[dict[str, Any]], NDArray[np.float32]]


def main() -> None:
    """Plays the three policies from the same starts and prints their rates."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=Path, help="write the rates to this file")
    parser.add_argument("--starts", type=int, default=STARTS)
    arguments = parser.parse_args()
    env: Any = gymnasium.make("ViTac/PegInsertion-v1", disable_env_checker=True).unwrapped
    rates = {name: play(env, arguments.starts, name) for name in ("example", "zero", "random")}
    for name, result in rates.items():
        print(f"{name:8} {result.success_rate:6.1%}  [{result.interval.low:.1%}, {result.interval.high:.1%}]")
    beaten = all(rates["example"].interval.low > rates[name].interval.high for name in ("zero", "random"))
    print("The example's interval lies above both others." if beaten else "The intervals overlap.")
    if arguments.json:
        content = {name: result.model_dump() for name, result in rates.items()}
        arguments.json.write_text(json.dumps(content, indent=1) + "\n")


def play(env: Any, starts: int, name: str) -> Rate:
    """Success rate of one policy."""
    successes = 0
    for number in range(starts):
        observation, _ = env.reset(options={"rng_seed": (SEED, number)})
        successes += episode(env, observation, actor(name, number))
    return rate(successes, starts)


def actor(name: str, number: int) -> Act:
    """What acts in one episode."""
    if name == "example":
        policy = Policy()
        policy.reset("peg-insertion")
        act: Act = policy.act
        return act
    if name == "zero":
        return lambda _: np.zeros(3, dtype=np.float32)
    random = np.random.default_rng([SEED, number])
    return lambda _: random.uniform(-1, 1, 3).astype(np.float32)


def episode(env: Any, observation: dict[str, Any], act: Act) -> bool:
    """Plays to the end; whether the peg went in."""
    while True:
        observation, _, terminated, truncated, _ = env.step(act(observation))
        if terminated or truncated:
            return bool(terminated)


if __name__ == "__main__":
    main()
