"""Counts the successes of a trained peg policy from fresh starts, which neither taught it nor chose it.

python benchmarks/trained_policy.py examples/peg_insertion_trained/Track_1 [--starts 300] [--seed 1] [--json FILE]

The public list is played by `vitac evaluate`, in the sandbox.
"""

import argparse
import json
from pathlib import Path
from runpy import run_path
from typing import Any

import numpy as np
from vitac.evaluator.episodes.episode import make_environment
from vitac.evaluator.scoring.score import rate
from vitac.evaluator.tracks import load_track
from vitac.training.streams import Use, stream


def main() -> None:
    """Play the starts and print the rates."""
    parser = argparse.ArgumentParser(description="successes of a trained policy from fresh starts")
    parser.add_argument("submission", type=Path, help="folder with policy.py")
    parser.add_argument("--starts", type=int, default=300)
    parser.add_argument("--seed", type=int, default=1, help="of the training run")
    parser.add_argument("--json", type=Path, help="write the figures to this file")
    chosen = parser.parse_args()
    found = figures(chosen.submission, chosen.seed, chosen.starts)
    print(json.dumps(found, indent=1))
    if chosen.json:
        chosen.json.write_text(json.dumps(found, indent=1) + "\n")


def figures(submission: Path, seed: int, starts: int) -> dict[str, Any]:
    """Return successes with their interval, also by shape, the mean env steps of successes, and how episodes ended."""
    task = load_track("track_1").tasks["peg-insertion"]
    env: Any = make_environment(task)
    policy = run_path(str(submission / "policy.py"))["Policy"]()
    rows = [played(env, policy, (stream(seed, Use.REPORT), number)) for number in range(starts)]
    solved = [row["end"] == "success" for row in rows]
    shapes = sorted({row["shape"] for row in rows})
    return {
        "starts": starts,
        "stream": stream(seed, Use.REPORT),
        **rate(sum(solved), starts).model_dump(),
        "mean_steps": float(np.mean([row["env_steps"] for row in rows if row["end"] == "success"] or [0])),
        "by_shape": {
            shape: rate(
                sum(row["end"] == "success" for row in rows if row["shape"] == shape),
                sum(row["shape"] == shape for row in rows),
            ).model_dump()
            for shape in shapes
        },
        "ends": {end: sum(row["end"] == end for row in rows) for end in sorted({row["end"] for row in rows})},
    }


def played(env: Any, policy: Any, rng_seed: tuple[int, int]) -> dict[str, Any]:
    """Return the shape of an episode, how it ended, and after how many env steps."""
    observation, info = env.reset(options={"rng_seed": rng_seed})
    policy.reset("peg-insertion")
    while info["end_reason"] is None:
        observation, _, _, _, info = env.step(policy.act(observation))
    return {"shape": str(env.task_scene.shape), "end": info["end_reason"], "env_steps": info["steps"]}


if __name__ == "__main__":
    main()
