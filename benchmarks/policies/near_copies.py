"""Which copies does the service find, and does it take honest policies for copies?

Usage: PYTHONPATH=benchmarks python benchmarks/policies/near_copies.py [--episodes N] [--starts N] [--json FILE]

Honest: the examples of peg and lock, fits of the peg example's recipe to other starts, and networks of one recipe and
the same starts that differ by their seed alone; every pair of a task is compared in both directions, and the archives.
Copies: the fusion example with one constant changed; the trained peg example's actions changed, later, or cut in two,
from a table or played; its weights tuned; code under other names.
"""

import argparse
import io
import json
import tokenize
from collections.abc import Callable, Mapping, Sequence
from itertools import combinations, pairwise
from keyword import iskeyword
from pathlib import Path
from runpy import run_path
from shutil import copytree
from sys import path as import_path
from tempfile import TemporaryDirectory
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray
from policies.table_attack import (
    EXAMPLES,
    MAX_MOTION,
    Act,
    Actions,
    Played,
    changed,
    play,
    policies,
    rate,
    record_trace,
)
from vitac.evaluator.scoring.near_copies import Likeness, Trace, compare_traces
from vitac.evaluator.submission.likeness import compare_sketches, make_sketch
from vitac.evaluator.tracks import Task
from vitac.evaluator.tracks.registry import find_task

NETWORKS = 4
HIDDEN, ROUNDS, RATE = 32, 1500, 3e-3
HOVERS_MM = (0.6, 0.8, 1.0)
TUNED = 0.01
"""Standard deviation of the change of weights, as a part of their own."""

Traces = dict[str, Trace]


def main() -> None:
    """Play, compare, and print the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--episodes", type=int, default=60, help="of the peg task; a third of it of the others")
    parser.add_argument("--starts", type=int, default=250, help="random starts to which fits and networks are made")
    parser.add_argument("--json", type=Path, help="write the figures to this file")
    arguments = parser.parse_args()
    few = max(1, arguments.episodes // 3)
    peg = find_task("peg-insertion")[1]
    networks = train_networks(peg, arguments.starts)
    begins = dict(policies(peg, arguments.starts)) | {
        name: begin_network(weights) for name, weights in networks.items()
    }
    played = {name: play(peg, peg.episodes[: arguments.episodes], begin) for name, begin in begins.items()}
    print({name: rate(rows) for name, rows in played.items()}, flush=True)
    groups = {"peg": {name: record_trace(rows) for name, rows in played.items()}}
    groups["lock"] = collect_examples("lock-opening", few, ("lock_opening_heuristic", "lock_opening_trained"))
    groups["fusion"] = fusion_with_other_constants(few)
    found: dict[str, Any] = {name: compare_all(traces) for name, traces in groups.items()}
    found["copies"] = compare_copies(peg, peg.episodes[: arguments.episodes], played["trained"], begins["trained"])
    found["archives"] = archives(networks)
    print(json.dumps(found, indent=1))
    if arguments.json:
        arguments.json.write_text(json.dumps(found, indent=1) + "\n")


def compare_all(traces: Traces) -> dict[str, Any]:
    """Return how many honest pairs are marked, and the largest shares of near episodes."""
    rows = []
    for first, second in combinations(traces, 2):
        alike = [compare_traces(traces[a], traces[b]) for a, b in ((first, second), (second, first))]
        rows.append((max(one.near / max(1, one.episodes) for one in alike), f"{first}, {second}", is_copy(*alike)))
    rows.sort(reverse=True)
    marked = [pair for _, pair, copy in rows if copy]
    return {"pairs": len(rows), "marked": marked, "largest": [(round(share, 3), pair) for share, pair, _ in rows[:4]]}


def is_copy(*found: Likeness) -> bool:
    """Return whether one of two policies would be marked, whichever came first."""
    return any(one.is_copy for one in found)


def train_networks(task: Task, starts: int) -> dict[str, list[NDArray[np.float64]]]:
    """Return networks from the first touch to the start, which differ by their seed alone."""
    features = run_path(str(EXAMPLES / "peg_insertion_heuristic" / "Track_1" / "policy.py"))["features"]
    env: Any = gymnasium.make(task.env_id, privileged=True, disable_env_checker=True).unwrapped
    seen, offsets = [], []
    for number in range(starts):
        observation, _ = env.reset(options={"rng_seed": (300, number)})
        seen.append(features(observation["marker_flow"]))
        offsets.append(observation["gt_offset"][:3] / MAX_MOTION)
    inputs, targets = np.array(seen), np.array(offsets)
    return {f"network {seed}": train_network(inputs, targets, np.random.default_rng(seed)) for seed in range(NETWORKS)}


def train_network(
    inputs: NDArray[np.float64], targets: NDArray[np.float64], random: np.random.Generator
) -> list[NDArray[np.float64]]:
    """Return the weights of a network with one hidden layer, trained by Adam."""
    sizes = (inputs.shape[1], HIDDEN, targets.shape[1])
    weights = [random.standard_normal((a, b)) / np.sqrt(a) for a, b in pairwise(sizes)]
    means, squares = ([np.zeros_like(each) for each in weights] for _ in range(2))
    for number in range(1, ROUNDS + 1):
        hidden = np.tanh(inputs @ weights[0])
        error = (hidden @ weights[1] - targets) / len(inputs)
        slopes = [inputs.T @ (error @ weights[1].T * (1 - hidden**2)), hidden.T @ error]
        for k, slope in enumerate(slopes):
            means[k] = 0.9 * means[k] + 0.1 * slope
            squares[k] = 0.999 * squares[k] + 0.001 * slope**2
            step = means[k] / (1 - 0.9**number) / (np.sqrt(squares[k] / (1 - 0.999**number)) + 1e-8)
            weights[k] = weights[k] - RATE * step
    return weights


def begin_network(weights: Sequence[NDArray[np.float64]]) -> Callable[[], Act]:
    """Return what begins an episode of a network that goes where it takes the hole to be."""
    features = run_path(str(EXAMPLES / "peg_insertion_heuristic" / "Track_1" / "policy.py"))["features"]

    def begin() -> Act:
        start: list[NDArray[np.float64]] = []

        def act(observation: Mapping[str, Any]) -> Actions:
            if not start:
                seen = features(observation["marker_flow"])
                start.append(MAX_MOTION * (np.tanh(seen @ weights[0]) @ weights[1]))
            way = -(start[0] + observation["relative_motion"][:3]) / MAX_MOTION
            action: Actions = np.clip(way, -1, 1).astype(np.float32)
            return action

        return act

    return begin


def collect_examples(name: str, episodes: int, folders: Sequence[str]) -> Traces:
    """Return the example submissions of a task as they play it."""
    task, found = find_task(name)[1], {}
    for folder in folders:
        made = run_path(str(EXAMPLES / folder / "Track_1" / "policy.py"))["Policy"]
        found[folder] = record_trace(play_own(task, episodes, made))
    return found


def fusion_with_other_constants(episodes: int) -> Traces:
    """Return the fusion example as it is, and travelling higher."""
    folder = EXAMPLES / "track_2_fusion" / "Track_2"
    import_path.insert(0, str(folder))
    task, found = find_task("fusion-insertion")[1], {}
    for hover in HOVERS_MM:
        made = run_path(str(folder / "policy.py"))
        made["Policy"].reset.__globals__["HOVER"] = hover
        found[f"hover {hover}"] = record_trace(play_own(task, episodes, made["Policy"]))
    return found


def play_own(task: Task, episodes: int, make: Callable[[], Any]) -> list[Played]:
    """Return the first episodes of a list as a submitted policy plays them."""

    def begin() -> Act:
        policy = make()
        policy.reset(task.name)
        return policy.act  # type: ignore[no-any-return]

    return play(task, task.episodes[:episodes], begin)


def compare_copies(
    task: Task, episodes: Sequence[Any], source: Sequence[Played], begin: Callable[[], Act]
) -> dict[str, Any]:
    """Return how much of each copy of a policy is near; logs and tables play what is given, the others look."""
    rng, kept = np.random.default_rng(0), record_trace(source)
    actions = {
        f"table changed by {by:g}": [changed(row.actions, by, rng) for row in source] for by in (1e-5, 1e-4, 1e-3, 1e-2)
    }
    actions["one env step later"] = [np.concatenate([0 * row.actions[:1], row.actions]) for row in source]
    actions["cut in two"] = [np.repeat(row.actions / 2, 2, axis=0) for row in source]
    found = {}
    for name, of_episodes in actions.items():
        queue = iter(of_episodes)
        rows = play(task, episodes, lambda queue=queue: repeat(next(queue)))  # type: ignore[misc]
        found[name] = figures(kept, rows)
    for by in (1e-3, 1e-2):
        found[f"policy with noise of {by:g}"] = figures(
            kept,
            play(task, episodes, lambda by=by: noisy(begin(), by, rng)),  # type: ignore[misc]
        )
    return found


def figures(source: Trace, rows: Sequence[Played]) -> dict[str, Any]:
    """Return whether a copy is found."""
    alike = compare_traces(source, record_trace(rows))
    return {"near": alike.near, "of": alike.episodes, "found": alike.is_copy, "success": round(rate(rows), 3)}


def repeat(actions: Actions) -> Act:
    """Return what plays actions, the last one again where they end."""
    left = list(actions)
    return lambda _: left.pop(0) if len(left) > 1 else left[0]


def noisy(act: Act, by: float, rng: np.random.Generator) -> Act:
    """Return what acts as another policy does, with noise."""
    return lambda observation: changed(act(observation), by, rng)


def archives(networks: Mapping[str, Sequence[NDArray[np.float64]]]) -> dict[str, Any]:
    """Return how alike archives are: of networks of one recipe, of examples, and of copies of one."""
    found: dict[str, Any] = {}
    with TemporaryDirectory() as folder:
        root = Path(folder)
        for name, weights in networks.items():
            (root / name).mkdir()
            (root / name / "policy.py").write_text(Path(__file__).read_text())
            np.savez(root / name / "weights.npz", *weights)
        made = {name: make_sketch(root / name) for name in networks}
        own = [path.parent for path in EXAMPLES.glob("*/Track_*/policy.py") if path.parts[-3] != "track_1_heuristic"]
        made |= {path.parent.name: make_sketch(path) for path in own}  # that one is made of two others
        for name, source, change in (
            ("renamed code", "lock_opening_heuristic", rename),
            ("tuned weights", "peg_insertion_trained", tune),
        ):
            copytree(EXAMPLES / source / "Track_1", root / name)
            change(root / name)
            alike = compare_sketches(made[source], make_sketch(root / name))
            found[name] = {"code": alike.code, "weights": alike.weights, "found": alike.is_copy}
    pairs = {pair: compare_sketches(*(made[name] for name in pair)) for pair in combinations(made, 2)}
    found["honest pairs"] = len(pairs)
    found["marked"] = [", ".join(pair) for pair, alike in pairs.items() if alike.is_copy]
    found["largest code of other recipes"] = max(
        (alike.code or 0.0, ", ".join(pair))
        for pair, alike in pairs.items()
        if not all("network" in name for name in pair)
    )
    found["largest weights"] = max((alike.weights or 0.0, ", ".join(pair)) for pair, alike in pairs.items())
    return found


def rename(folder: Path) -> None:
    """Give all names that a file of code has of its own other ones."""
    for path in folder.glob("*.py"):
        tokens, last = [], ""
        for token in tokenize.tokenize(io.BytesIO(path.read_bytes()).readline):
            own = token.type == tokenize.NAME and not iskeyword(token.string) and last != "."
            tokens.append((token.type, f"x_{token.string}" if own else token.string))
            last = token.string
        renamed = tokenize.untokenize(tokens)
        path.write_bytes(renamed.encode() if isinstance(renamed, str) else renamed)


def tune(folder: Path) -> None:
    """Change all weights a little."""
    random = np.random.default_rng(0)
    for path in folder.glob("weights*.npz"):
        with np.load(path) as stored:
            arrays = {name: stored[name] for name in stored.files}
        tuned = {
            name: array + TUNED * array.std() * random.standard_normal(array.shape)
            if array.dtype.kind == "f"
            else array
            for name, array in arrays.items()
        }
        np.savez(path, **tuned)


if __name__ == "__main__":
    main()
