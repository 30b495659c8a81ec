"""Counts the IPC steps that are not solved, in resets and in random episodes of all tactile tasks.

Usage: python benchmarks/unsolved.py [--resets N] [--episodes N] [--first SEED] [--task ID ...] [--workers 2]
       [--contact-model NAME] [--intersections] [--store FILE]

Every reset draws its start as a training run does, from seed SEED on. Half of an episode's actions have every component
at a bound, the others are anywhere; it is played to its end, or 20 env steps of lock opening. With `--intersections`
the IPC Toolkit looks after every reset and every IPC step that follows whether bodies intersect, and states that are
not finite are found. Resets and episodes of all tasks take turns in pieces of 25 seeds; after each the totals of its
task are printed as a line of JSON. With `--store` finished pieces are lines of the file, and the same command continues
from them after a kill. Several machines share the work by different `--first`. Exit code 1 where an IPC step is not
solved, or a state is wrong.
"""

import argparse
import json
import sys
import time
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium
import numpy as np
from vitac.envs import ENVIRONMENTS
from vitac.envs.fem.model.settings import ContactModel
from vitac.envs.fem.scene.report import StepStatus
from vitac.envs.scene.grasped_scene import GraspedScene
from vitac.evaluator.version import evaluator_hash

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "support" / "physics"))

LONGEST_EPISODE = 20
PIECE_SEEDS = 25


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
    """How many seeds were played, how their IPC steps ended, what was seen, and the CPU time [s].

    `unsolved` are the seeds with an IPC step that is not solved, `wrong` those with a state that intersects or is not
    finite, of the `states` that were looked at.
    """

    seeds: int = 0
    statuses: Counter[str] = field(default_factory=Counter[str])
    unsolved: list[int] = field(default_factory=list[int])
    wrong: list[int] = field(default_factory=list[int])
    states: int = 0
    cpu_s: float = 0.0

    def add(self, other: "Counted") -> None:
        """Add what was counted elsewhere."""
        self.seeds += other.seeds
        self.statuses.update(other.statuses)
        self.unsolved += other.unsolved
        self.wrong += other.wrong
        self.states += other.states
        self.cpu_s = round(self.cpu_s + other.cpu_s, 1)


class Way(NamedTuple):
    """How episodes are played; without env steps they are resets only."""

    task: str
    contact_model: str | None
    env_steps: int
    looks: bool

    @property
    def what(self) -> str:
        """What is played."""
        return "episodes" if self.env_steps else "resets"


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
    count, began = Counted(seeds=len(seeds)), time.process_time()
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


def pieces(ways: list[tuple[Way, int]], first: int) -> Iterator[tuple[Way, range]]:
    """Give each way's seeds in pieces; the ways take turns."""
    for start in range(0, max(count for _, count in ways), PIECE_SEEDS):
        for way, count in ways:
            if start < count:
                yield way, range(first + start, first + min(start + PIECE_SEEDS, count))


def name_piece(way: Way, seeds: range) -> str:
    """Return what names a stored piece: all that decides what is counted in it."""
    return json.dumps([*way, seeds.start, seeds.stop, evaluator_hash()])


def read_store(store: Path | None) -> dict[str, Counted]:
    """Return the finished pieces of a file; a line that a kill cut is none."""
    counts: dict[str, Counted] = {}
    for line in store.read_text().splitlines() if store and store.exists() else ():
        with suppress(json.JSONDecodeError):
            name, count = json.loads(line)
            counts[name] = Counted(**count | {"statuses": Counter(count["statuses"])})
    return counts


def play_missing(
    chosen: list[tuple[Way, range]], store: Path | None, workers: int
) -> Iterator[tuple[Way, range, Counted]]:
    """Give all pieces with what was counted, stored ones first, and store each that is played."""
    stored = read_store(store)
    missing = []
    for way, seeds in chosen:
        count = stored.get(name_piece(way, seeds))
        if count is None:
            missing.append((way, seeds))
        else:
            yield way, seeds, count
    with ProcessPoolExecutor(workers) as pool:
        for (way, seeds), count in zip(missing, pool.map(counted, *zip(*missing, strict=True)), strict=True):
            if store:
                with store.open("a", encoding="utf-8") as file:
                    file.write("\n" + json.dumps([name_piece(way, seeds), vars(count)]))
            yield way, seeds, count


def main() -> None:
    """Count, and print a line of JSON after each piece."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--resets", type=int, default=10_000)
    parser.add_argument("--episodes", type=int, default=2_000)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--task", nargs="+", choices=list(ENVIRONMENTS), default=list(ENVIRONMENTS))
    parser.add_argument("--contact-model", choices=list(ContactModel), help="by default that of each task")
    parser.add_argument("--intersections", action="store_true")
    parser.add_argument("--store", type=Path, metavar="FILE", help="finished pieces, from which a run continues")
    parser.add_argument("--workers", type=int, default=2)
    arguments = parser.parse_args()
    ways = [
        (Way(task, arguments.contact_model, env_steps, arguments.intersections), count)
        for count, env_steps in ((arguments.resets, 0), (arguments.episodes, LONGEST_EPISODE))
        for task in arguments.task
    ]
    totals = {way: Counted() for way, _ in ways}
    for way, _, count in play_missing(list(pieces(ways, arguments.first)), arguments.store, arguments.workers):
        totals[way].add(count)
        print(json.dumps({"task": way.task, "what": way.what, **vars(totals[way])}), flush=True)
    sys.exit(any(total.unsolved or total.wrong for total in totals.values()))


if __name__ == "__main__":
    main()
