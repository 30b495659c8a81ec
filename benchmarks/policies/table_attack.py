"""Measures what a table of another team's actions is worth, and whether the service finds it; and honest policies.

Usage: python benchmarks/policies/table_attack.py [--episodes N] [--starts N] [--search S] [--attack-only] [--json FILE]

Honest policies of the peg task: the trained and the fitted example, fits of the same recipe to other training starts,
and variants of the fitted one. Each plays the beginning of the public list; every pair is compared. The table holds the
trained example's actions, changed by 1e-5; as a log it plays them, as a model it takes the row whose first
observation is nearest. It is improved against the public list, whose starts everybody knows, for `--search` seconds.
Model and table also play as many starts of a sealed list.
"""

import argparse
import json
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path
from runpy import run_path
from time import monotonic
from typing import Any

import gymnasium
import numpy as np
import vitac.envs  # noqa: F401 - registers the environment
from numpy.typing import NDArray
from vitac.evaluator.episodes.episode import make_environment
from vitac.evaluator.scoring.near_copies import Trace, compare_traces, make_trace
from vitac.evaluator.tracks import Episode, Task, load_track
from vitac.evaluator.tracks.sealed import sealed_track

EXAMPLES = Path(__file__).parents[2] / "examples"
FITTED, TRAINED = EXAMPLES / "peg_insertion_heuristic", EXAMPLES / "peg_insertion_trained"
TASK = "peg-insertion"
SECRET = b"table attack".ljust(32)
FITS = 7
CHANGE = 1e-5
"""Of each action of the table."""
SEARCHED = 0.05
"""Standard deviation of the changes that the search tries."""
MAX_MOTION = np.array([2.0, 2.0, 4.0])
"""Of an action of 1 [mm, mm, degrees]."""

Actions = NDArray[np.float32]
Act = Callable[[Mapping[str, Any]], Actions]


@dataclass(frozen=True, kw_only=True)
class Played:
    """An episode: its first observation, its actions, the infos of its env steps, and whether it was solved."""

    first: NDArray[np.float32]
    actions: Actions
    infos: list[dict[str, Any]]
    success: bool


class Table:
    """A policy that plays the recorded actions of the episode whose first observation is nearest."""

    def __init__(self, rows: Sequence[Played]) -> None:
        self.first, self.rows = np.stack([row.first for row in rows]), rows

    def begin(self) -> Act:
        """Return what acts in one episode."""
        steps: list[Actions] = []

        def act(observation: Mapping[str, Any]) -> Actions:
            if not steps:
                seen = observation["marker_flow"].ravel()
                row = self.rows[int(np.abs(self.first - seen).sum(axis=1).argmin())]
                steps.extend(row.actions)
            return steps.pop(0) if len(steps) > 1 else steps[0]

        return act


def main() -> None:
    """Play, compare, attack, and print the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--episodes", type=int, default=90, help="of each list")
    parser.add_argument("--starts", type=int, default=250, help="random starts to which each fit is made")
    parser.add_argument("--search", type=float, default=18.0, help="time to improve the table [s]")
    parser.add_argument("--attack-only", action="store_true", help="play no honest policy but the source")
    parser.add_argument("--json", type=Path, help="write the figures to this file")
    arguments = parser.parse_args()
    track = load_track("track_1")
    public, sealed = (each.tasks[TASK] for each in (track, sealed_track(track, SECRET)))
    episodes = slice(0, arguments.episodes)
    begun = [("trained", dict(policies(public, 0))["trained"])] if arguments.attack_only else None
    honest = {
        name: play(public, public.episodes[episodes], begin)
        for name, begin in begun or policies(public, arguments.starts)
    }
    figures: dict[str, Any] = {} if arguments.attack_only else {"honest": compare_all(honest)}
    source = honest["trained"]
    rng = np.random.default_rng(0)
    rows = [replace(row, actions=changed(row.actions, CHANGE, rng)) for row in source]
    improved = improve(public, public.episodes[episodes], rows, arguments.search, rng)
    begins = {
        "source": dict(policies(public, 0))["trained"],
        "table": Table(rows).begin,
        "improved": Table(improved).begin,
    }
    for name, begin in begins.items():
        on_public = play(public, public.episodes[episodes], begin)
        on_sealed = play(sealed, sealed.episodes[episodes], begin)
        alike = likeness(source, on_public)
        figures[name] = {"public": rate(on_public), "sealed": rate(on_sealed), "near": alike.near, "of": alike.episodes}
        print(name, figures[name], flush=True)
    if arguments.json:
        arguments.json.write_text(json.dumps(figures, indent=1) + "\n")


def policies(task: Task, starts: int) -> list[tuple[str, Callable[[], Act]]]:
    """Return honest policies by name; without starts no fits."""
    fitted, trained = (run_path(str(folder / "Track_1" / "policy.py"))["Policy"] for folder in (FITTED, TRAINED))

    def begin(make: Callable[[], Any]) -> Callable[[], Act]:
        def begun() -> Act:
            policy = make()
            policy.reset(task.name)
            return policy.act  # type: ignore[no-any-return]

        return begun

    def variant(weights: Sequence[Mapping[str, Any]], gain: float = 1.0) -> Callable[[], Any]:
        def make() -> Any:
            policy = fitted()
            policy.regressions = [
                {key: np.array(value) * (gain if key == "weights" else 1.0) for key, value in of_step.items()}
                for of_step in weights
            ]
            return policy

        return make

    known = json.loads((FITTED / "Track_1" / "weights.json").read_text())
    found = {"trained": trained, "fitted": fitted, "first only": variant(known[:1]), "gain 0.8": variant(known, 0.8)}
    if starts:
        found |= {f"fit {seed}": variant([weights]) for seed, weights in enumerate(fits(task, starts))}
    return [(name, begin(make)) for name, make in found.items()]


def fits(task: Task, starts: int) -> list[Mapping[str, Any]]:
    """Return the first regression of the fitted example, made from other random starts each time."""
    sys.path.insert(0, str(FITTED / "Track_1"))
    recipe = run_path(str(FITTED / "train.py"))
    features = run_path(str(FITTED / "Track_1" / "policy.py"))["features"]
    env = gymnasium.make(task.env_id, privileged=True, disable_env_checker=True).unwrapped
    found = []
    for seed in range(FITS):
        flows, offsets = [], []
        for number in range(starts):
            observation, _ = env.reset(options={"rng_seed": (100 + seed, number)})
            motion = observation["relative_motion"][:3]
            flows.append(np.concatenate([features(observation["marker_flow"]), motion]))
            offsets.append(observation["gt_offset"] - motion)
        found.append(recipe["fit"](np.array(flows), np.array(offsets), recipe["GAINS"][0])[0])
        print(f"fit {seed}", flush=True)
    return found


def play(task: Task, episodes: Sequence[Episode], begin: Callable[[], Act]) -> list[Played]:
    """Return the episodes as a policy plays them."""
    env = make_environment(task)
    return [play_one(env, episode, begin()) for episode in episodes]


def play_one(env: Any, episode: Episode, act: Act) -> Played:
    """Return one episode."""
    observation, _ = env.reset(options=episode.options)
    first, actions, infos, ended = observation["marker_flow"].ravel(), [], [], False
    while not ended:
        actions.append(np.asarray(act(observation), np.float32))
        observation, _, terminated, truncated, info = env.step(actions[-1])
        infos.append(info)
        ended = terminated or truncated
    return Played(first=first, actions=np.stack(actions), infos=infos, success=bool(infos[-1]["is_success"]))


def changed(actions: Actions, by: float, rng: np.random.Generator) -> Actions:
    """Return actions with noise."""
    return np.clip(actions + by * rng.standard_normal(actions.shape), -1, 1).astype(np.float32)


def improve(
    task: Task, episodes: Sequence[Episode], rows: list[Played], search_s: float, rng: np.random.Generator
) -> list[Played]:
    """Return the table after a search that replaces the actions of what it does not solve.

    It goes from the start, which the public list tells, to the hole, with noise that differs from try to try.
    """
    env, until, found = make_environment(task), monotonic() + search_s, list(rows)
    while monotonic() < until and (failed := [at for at, row in enumerate(found) if not row.success]):
        at = failed[int(rng.integers(len(failed)))]
        played = play_one(env, episodes[at], to_the_hole(episodes[at].offset, rng))
        if played.success:
            found[at] = played
    return found


def to_the_hole(offset: Sequence[float], rng: np.random.Generator) -> Act:
    """Return what moves from a known offset [mm, mm, degrees] to the hole."""

    def act(observation: Mapping[str, Any]) -> Actions:
        motion = observation["relative_motion"][:3]
        x, y, theta = -(np.array(offset) + motion)
        angle = np.radians(motion[2])
        own = np.array([np.cos(angle) * x + np.sin(angle) * y, np.cos(angle) * y - np.sin(angle) * x, theta])
        return changed((own / MAX_MOTION).astype(np.float32), SEARCHED, rng)

    return act


def likeness(earlier: Sequence[Played], later: Sequence[Played]) -> Any:
    """Return how alike two policies are on the same episodes."""
    return compare_traces(*(record_trace(rows) for rows in (earlier, later)))


def record_trace(rows: Sequence[Played]) -> Trace:
    """Return what played episodes are compared by."""
    return make_trace([row.actions for row in rows], rows[0].actions.shape[1], [row.infos for row in rows])


def compare_all(honest: Mapping[str, Sequence[Played]]) -> dict[str, Any]:
    """Return and print how alike all pairs are."""
    rows = []
    for first, second in combinations(honest, 2):
        alike = likeness(honest[first], honest[second])
        rows.append((alike.near / max(1, alike.episodes), alike.difference, first, second, alike.is_copy))
    rows.sort(reverse=True)
    for share, difference, first, second, is_copy in rows:
        print(f"{first:12} {second:12} near {share:6.1%}  median difference {difference:.3f}  copy {is_copy}")
    print({name: rate(played) for name, played in honest.items()})
    return {"pairs": len(rows), "marked": sum(row[-1] for row in rows), "largest_share": rows[0][0]}


def rate(played: Sequence[Played]) -> float:
    """Return the success rate."""
    return sum(row.success for row in played) / len(played)


if __name__ == "__main__":
    main()
