"""Plays policies under both contact models: success by shape, what is lost, forces, and how the marker flow differs.

Usage: python benchmarks/contact/models.py [POLICY ...] [--every 6] [--picture PNG]

POLICY is the name of an example, by default each of them; all were made under challenge-2025. Or it is TASK=FOLDER,
with a `policy.py` in the folder. It runs in this process, so play only what you trust. Of the task's public list every
N-th episode is played. One thread; the fusion example takes about a second per env step.
"""

import argparse
import importlib.util
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray
from vitac.envs.fem.model.settings import ContactModel
from vitac.evaluator.episodes.episode import make_environment
from vitac.evaluator.scoring.comparison import paired_interval
from vitac.evaluator.scoring.score import rate_by_start
from vitac.evaluator.scoring.starts import group_by_start
from vitac.evaluator.tracks import Episode, Task, find_task

EXAMPLES = Path(__file__).parents[2] / "examples"
POLICIES = {
    "peg_insertion_heuristic": ("peg-insertion", "Track_1"),
    "peg_insertion_trained": ("peg-insertion", "Track_1"),
    "lock_opening_heuristic": ("lock-opening", "Track_1"),
    "lock_opening_trained": ("lock-opening", "Track_1"),
    "track_2_fusion": ("fusion-insertion", "Track_2"),
}


@dataclass(kw_only=True)
class Played:
    """One episode: its start, whether it succeeded, forces [N], and the marker flow after the grasp and an env step."""

    start: tuple[str, tuple[float, ...]]
    success: bool
    flows: list[NDArray[np.float32]]
    part_forces_n: list[float] = field(default_factory=list)
    gel_forces_n: list[float] = field(default_factory=list)


def find_policy(name: str) -> tuple[str, Path]:
    """Return task and folder of an example or of TASK=FOLDER."""
    if "=" in name:
        task_name, folder = name.split("=", 1)
        return task_name, Path(folder)
    if name not in POLICIES:
        raise SystemExit(f"Expected TASK=FOLDER or one of {', '.join(POLICIES)}, got {name}.")
    task_name, track = POLICIES[name]
    return task_name, EXAMPLES / name / track


def read_policy(folder: Path) -> Any:
    """Return the policy of an example, which may import what lies beside it."""
    sys.path.insert(0, str(folder))
    spec = importlib.util.spec_from_file_location("policy", folder / "policy.py")
    if spec is None or spec.loader is None:
        raise SystemExit(f"Expected a file policy.py in {folder}.")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.Policy()


def play(env: Any, task: Task, episode: Episode, policy: Any) -> Played:
    """Play one episode to its end."""
    observation, info = env.reset(options=episode.options)
    policy.reset(task.name)
    played = Played(start=(episode.shape, episode.offset), success=False, flows=[observation["marker_flow"].copy()])
    for _ in range(task.max_steps):
        action = np.clip(np.asarray(policy.act(observation), dtype=np.float32), -1, 1)
        observation, *_, info = env.step(action)
        if len(played.flows) == 1:
            played.flows.append(observation["marker_flow"].copy())
        played.part_forces_n += [report.part_force_n for report in info["step_reports"]]
        played.gel_forces_n += [
            float(np.linalg.norm(force)) for report in info["step_reports"] for force in report.gel_forces_n
        ]
        if info["end_reason"] is not None:
            break
    played.success = info["end_reason"] == "success"
    return played


def print_rates(name: str, episodes: list[Played]) -> None:
    """Print success with its interval by shape, and forces over all IPC steps."""
    for shape in ["all", *dict.fromkeys(played.start[0] for played in episodes)]:
        chosen = rate_by_start(
            (played.start, played.success) for played in episodes if shape in ("all", played.start[0])
        )
        bounds = f"[{100 * chosen.interval.low:.1f}, {100 * chosen.interval.high:.1f}]"
        print(f"{name} {shape}: {100 * chosen.success_rate:.1f} % {bounds} of {chosen.episodes}")
    for what, lists in (
        ("part", [played.part_forces_n for played in episodes]),
        ("gel", [played.gel_forces_n for played in episodes]),
    ):
        peaks, highest = [max(forces) for forces in lists], [np.percentile(forces, 95) for forces in lists]
        print(
            f"{name} force on the {what} [N], medians of episodes: largest {np.median(peaks):.2f} "
            f"(of all {max(peaks):.1f}), 95th percentile {np.median(highest):.2f}"
        )


def print_loss(old: list[Played], new: list[Played]) -> None:
    """Print by how much success falls from the first model to the second, on the same episodes."""
    pairs = [(first.success, second.success) for first, second in zip(old, new, strict=True)]
    only_old, only_new = pairs.count((True, False)), pairs.count((False, True))
    differences = ((first.start, first.success - second.success) for first, second in zip(old, new, strict=True))
    low, high = paired_interval(group_by_start(differences))
    print(
        f"loses {100 * (only_old - only_new) / len(pairs):.1f} points [{100 * low:.1f}, {100 * high:.1f}] "
        f"({only_old} of {len(pairs)} succeed only under the first, {only_new} only under the second)"
    )


def print_flows(old: list[Played], new: list[Played]) -> None:
    """Print how far markers move and how far apart they are between the models; the first action may differ already."""
    for k, when in enumerate(("the grasp", "the first env step")):
        flows = [
            np.array([played.flows[k][:, 1] - played.flows[k][:, 0] for played in episodes]) for episodes in (old, new)
        ]
        moved, changed = (np.sqrt((flow**2).sum(axis=-1).mean()) for flow in (flows[0], flows[1] - flows[0]))
        print(f"marker flow after {when}: {moved:.2f} pixels, differs by {changed:.2f} between the models (both RMS)")


@dataclass(frozen=True, kw_only=True)
class Bar:
    """What is drawn of an example under one model: success with its interval [%], and the force on a gel [N]."""

    success: float
    low: float
    high: float
    force_n: float


def draw(bars: dict[str, dict[str, Bar]], path: Path) -> None:
    """Draw success and forces of examples, bars for each model side by side."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8, 3), layout="constrained")
    left, right = figure.subplots(1, 2)
    for number, model in enumerate(ContactModel):
        shown = [of_example[str(model)] for of_example in bars.values()]
        places = np.arange(len(shown)) + 0.4 * number - 0.2
        ends = [bar.success - bar.low for bar in shown], [bar.high - bar.success for bar in shown]
        left.bar(places, [bar.success for bar in shown], 0.38, yerr=ends, capsize=3, label=str(model))
        right.bar(places, [bar.force_n for bar in shown], 0.38, label=str(model))
    left.set(ylabel="success on the public list [%]", ylim=(0, 105))
    right.set(ylabel="largest force on a gel [N], median")
    for axis in (left, right):
        axis.set_xticks(range(len(bars)), [name.replace("_", "\n") for name in bars], fontsize=7)
    left.legend(fontsize=7)
    figure.savefig(path, dpi=110)


def measure_bar(episodes: list[Played]) -> Bar:
    """Return what is drawn of the episodes under one model."""
    rate = rate_by_start((played.start, played.success) for played in episodes)
    force_n = float(np.median([max(played.gel_forces_n) for played in episodes]))
    return Bar(
        success=100 * rate.success_rate, low=100 * rate.interval.low, high=100 * rate.interval.high, force_n=force_n
    )


def compare_models(name: str, every: int) -> dict[str, Bar]:
    """Play an example under both models, print, and return what is drawn of it."""
    task_name, folder = find_policy(name)
    _, task = find_task(task_name)
    policy, runs = read_policy(folder), []
    print(f"== {name}")
    for model in ContactModel:
        chosen = task.model_copy(update={"settings": task.settings | {"contact_model": str(model)}})
        env = make_environment(chosen, None, seen_keys(folder, task))
        runs.append([play(env, chosen, episode, policy) for episode in task.episodes[::every]])
        print_rates(str(model), runs[-1])
    print_loss(*runs)
    print_flows(*runs)
    return {str(model): measure_bar(episodes) for model, episodes in zip(ContactModel, runs, strict=True)}


def seen_keys(folder: Path, task: Task) -> tuple[str, ...]:
    """Return what a submission asks to observe, by default all that its task shows."""
    asked = yaml.safe_load((folder / "submission.yaml").read_text()).get("observation_keys")
    return tuple(asked or (observable.name for observable in task.observables))


def main() -> None:
    """Play and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("policies", nargs="*", metavar="POLICY", help=", ".join(POLICIES))
    parser.add_argument("--every", type=int, default=6)
    parser.add_argument("--picture", type=Path, metavar="PNG", help="draw success and forces; needs Matplotlib")
    arguments = parser.parse_args()
    bars = {name: compare_models(name, arguments.every) for name in arguments.policies or POLICIES}
    if arguments.picture:
        draw(bars, arguments.picture)


if __name__ == "__main__":
    main()
