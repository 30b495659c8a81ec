"""Counts the IPC steps that are not solved, in resets and in random episodes of all tactile tasks.

Usage: python benchmarks/unsolved.py [--resets N] [--episodes N] [--first SEED] [--task ID ...] [--workers 2]
       [--contact-model NAME] [--intersections]

Every reset draws its start as a training run does, from seed SEED on. Half of an episode's actions have every component
at a bound, the others are anywhere; it is played to its end, or 20 env steps of lock opening. With `--intersections`
the IPC Toolkit looks after every reset and every IPC step that follows whether bodies intersect, and states that are
not finite are found. Prints a line of JSON for each task, with what plays an unsolved one again. Exit code 1 where an
IPC step is not solved, or a state is wrong.
"""

import argparse
import json
import sys
import time
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from vitac.envs import ENVIRONMENTS
from vitac.envs.fem.model.settings import ContactModel
from vitac.envs.fem.scene.scene import StepStatus
from vitac.envs.scene.grasped_scene import GraspedScene

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "support" / "physics"))

LONGEST_EPISODE = 20


@dataclass(kw_only=True)
class Look:
    """What the IPC Toolkit saw of one episode: states looked at, with intersecting bodies, and not finite."""

    states: int = 0
    intersecting: int = 0
    not_finite: int = 0

    def watch(self, scene: GraspedScene) -> None:
        """Look at a scene now and after each of its IPC steps."""
        from intersection_check import GraspedSceneCheck

        check = GraspedSceneCheck(scene)

        def look() -> None:
            self.states += 1
            self.not_finite += not all(np.isfinite(scene.gel_nodes_m(index)).all() for index in (0, 1))
            self.intersecting += check.intersects(scene)

        look()
        scene.after_ipc_step = look


@dataclass(kw_only=True)
class Counted:
    """How IPC steps ended, the seeds with one that is not solved, what was seen, and the CPU time [s]."""

    statuses: Counter[str] = field(default_factory=Counter[str])
    unsolved: list[int] = field(default_factory=list[int])
    wrong: list[int] = field(default_factory=list[int])
    states: int = 0
    cpu_s: float = 0.0


@dataclass(frozen=True, kw_only=True)
class Way:
    """How episodes are played."""

    task: str
    contact_model: str | None
    env_steps: int
    looks: bool


def played(env: Any, seed: int, env_steps: int, look: Look | None = None) -> list[str]:
    """Play an episode up to a number of env steps; return how its IPC steps ended."""
    random = np.random.default_rng(seed)
    _, info = env.reset(seed=seed)
    if look:
        look.watch(env.scene)
    statuses = [str(report.status) for report in info["step_reports"]]
    for _ in range(env_steps):
        if info["end_reason"] is not None:
            break
        action = random.uniform(-1, 1, env.action_space.shape)
        *_, info = env.step((np.sign(action) if random.random() < 0.5 else action).astype(np.float32))
        statuses += [str(report.status) for report in info["step_reports"]]
    return statuses


def counted(way: Way, seeds: range) -> Counted:
    """Play and count."""
    env: Any = gymnasium.make(
        way.task, disable_env_checker=True, observation_keys=(), contact_model=way.contact_model
    ).unwrapped
    count, began = Counted(), time.process_time()
    for seed in seeds:
        look = Look() if way.looks else None
        statuses = played(env, seed, way.env_steps, look)
        count.statuses.update(statuses)
        count.unsolved += [seed] * (StepStatus.NOT_CONVERGED in statuses)
        if look:
            count.states += look.states
            count.wrong += [seed] * (look.intersecting + look.not_finite > 0)
    count.cpu_s = time.process_time() - began
    return count


def measured(way: Way, seeds: range, pool: ProcessPoolExecutor) -> dict[str, Any]:
    """Count over all seeds, in pieces of 50."""
    pieces = [seeds[k : k + 50] for k in range(0, len(seeds), 50)]
    results = list(pool.map(counted, [way] * len(pieces), pieces))
    found: dict[str, Any] = {
        "task": way.task,
        "what": "episodes" if way.env_steps else "resets",
        "seeds": [seeds.start, seeds.stop - 1],
        "ipc_steps": dict(sum((result.statuses for result in results), Counter[str]())),
        "cpu_s": round(sum(result.cpu_s for result in results)),
        "unsolved": [seed for result in results for seed in result.unsolved],
    }
    if way.looks:
        found["states_looked_at"] = sum(result.states for result in results)
        found["intersecting_or_not_finite"] = [seed for result in results for seed in result.wrong]
    return found


def main() -> None:
    """Count, and print a line of JSON for each task."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--resets", type=int, default=10_000)
    parser.add_argument("--episodes", type=int, default=2_000)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--task", nargs="+", choices=list(ENVIRONMENTS), default=list(ENVIRONMENTS))
    parser.add_argument("--contact-model", choices=list(ContactModel), help="by default that of each task")
    parser.add_argument("--intersections", action="store_true")
    parser.add_argument("--workers", type=int, default=2)
    arguments = parser.parse_args()
    failed = False
    with ProcessPoolExecutor(arguments.workers) as pool:
        for count, env_steps in ((arguments.resets, 0), (arguments.episodes, LONGEST_EPISODE)):
            for task in arguments.task if count else ():
                way = Way(
                    task=task, contact_model=arguments.contact_model, env_steps=env_steps, looks=arguments.intersections
                )
                found = measured(way, range(arguments.first, arguments.first + count), pool)
                print(json.dumps(found), flush=True)
                failed = failed or bool(found["unsolved"] or found.get("intersecting_or_not_finite"))
    sys.exit(int(failed))


if __name__ == "__main__":
    main()
