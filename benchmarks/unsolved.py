"""Counts the IPC steps that are not solved, in resets and in random episodes of all tactile tasks.

Usage: python benchmarks/unsolved.py [--resets N] [--episodes N] [--first SEED] [--task ID ...] [--workers 2]
       [--contact-model NAME]

Every reset draws its start as a training run does, from seed SEED on. Half of an episode's actions have every component
at a bound, the others are anywhere; it is played to its end, or 20 env steps of lock opening. Prints a line of JSON for
each task, with what plays an unsolved one again. Exit code 1 where one is not solved.
"""

import argparse
import json
import sys
import time
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from typing import Any

import gymnasium
import numpy as np
from vitac.envs import ENVIRONMENTS
from vitac.envs.fem.model.settings import ContactModel
from vitac.envs.fem.scene.scene import StepStatus

LONGEST_EPISODE = 20


def played(env: Any, seed: int, env_steps: int) -> list[str]:
    """Play an episode of at most so many env steps; return how its IPC steps ended."""
    random = np.random.default_rng(seed)
    _, info = env.reset(seed=seed)
    statuses = [str(report.status) for report in info["step_reports"]]
    for _ in range(env_steps):
        if info["end_reason"] is not None:
            break
        action = random.uniform(-1, 1, env.action_space.shape)
        *_, info = env.step((np.sign(action) if random.random() < 0.5 else action).astype(np.float32))
        statuses += [str(report.status) for report in info["step_reports"]]
    return statuses


def counted(
    task: str, contact_model: str | None, env_steps: int, seeds: range
) -> tuple[Counter[str], list[int], float]:
    """Count how IPC steps ended, list the seeds with one that is not solved, and the CPU time [s]."""
    env: Any = gymnasium.make(
        task, disable_env_checker=True, observation_keys=(), contact_model=contact_model
    ).unwrapped
    count, unsolved, began = Counter[str](), [], time.process_time()
    for seed in seeds:
        statuses = played(env, seed, env_steps)
        count.update(statuses)
        unsolved += [seed] * (StepStatus.NOT_CONVERGED in statuses)
    return count, unsolved, time.process_time() - began


def measured(
    task: str, contact_model: str | None, seeds: range, env_steps: int, pool: ProcessPoolExecutor
) -> dict[str, Any]:
    """Count over all seeds, in pieces of 50."""
    pieces = [seeds[k : k + 50] for k in range(0, len(seeds), 50)]
    results = list(pool.map(partial(counted, task, contact_model, env_steps), pieces))
    return {
        "task": task,
        "what": "episodes" if env_steps else "resets",
        "seeds": [seeds.start, seeds.stop - 1],
        "ipc_steps": dict(sum((count for count, _, _ in results), Counter[str]())),
        "cpu_s": round(sum(cpu_s for _, _, cpu_s in results)),
        "unsolved": [seed for _, unsolved, _ in results for seed in unsolved],
    }


def main() -> None:
    """Count, and print a line of JSON for each task."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--resets", type=int, default=10_000)
    parser.add_argument("--episodes", type=int, default=2_000)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--task", nargs="+", choices=list(ENVIRONMENTS), default=list(ENVIRONMENTS))
    parser.add_argument("--contact-model", choices=list(ContactModel), help="by default that of each task")
    parser.add_argument("--workers", type=int, default=2)
    arguments = parser.parse_args()
    failed = False
    with ProcessPoolExecutor(arguments.workers) as pool:
        for count, env_steps in ((arguments.resets, 0), (arguments.episodes, LONGEST_EPISODE)):
            for task in arguments.task if count else ():
                found = measured(
                    task, arguments.contact_model, range(arguments.first, arguments.first + count), env_steps, pool
                )
                print(json.dumps(found), flush=True)
                failed = failed or bool(found["unsolved"])
    sys.exit(int(failed))


if __name__ == "__main__":
    main()
