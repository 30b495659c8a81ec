"""Plays one policy under both contact models: success by shape, forces, and how much of the marker flow differs.

Usage: python benchmarks/contact/models.py [SUBMISSION] [--task peg-insertion] [--every 6]

SUBMISSION is a folder with a `policy.py`, by default the peg heuristic, which was fitted under challenge-2025. It runs
in this process, so play only what you trust. Of a task's public list every N-th episode is played; one thread.
"""

import argparse
import importlib.util
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from vitac.envs.fem.model.settings import ContactModel
from vitac.evaluator.episodes.episode import make_environment
from vitac.evaluator.scoring.score import wilson_interval
from vitac.evaluator.tracks import Episode, Task, find_task

EXAMPLE = Path(__file__).parents[2] / "examples" / "peg_insertion_heuristic" / "Track_1"


@dataclass(kw_only=True)
class Played:
    """One episode: whether it succeeded, forces [N], and the marker flow after the grasp."""

    shape: str
    success: bool
    flow: NDArray[np.float32]
    part_forces_n: list[float] = field(default_factory=list)
    gel_forces_n: list[float] = field(default_factory=list)


def read_policy(folder: Path) -> Any:
    """Return the policy of a submission."""
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
    played = Played(shape=episode.shape, success=False, flow=observation["marker_flow"].copy())
    for _ in range(task.max_steps):
        action = np.clip(np.asarray(policy.act(observation), dtype=np.float32), -1, 1)
        observation, *_, info = env.step(action)
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
    for shape in ["all", *dict.fromkeys(played.shape for played in episodes)]:
        chosen = [played.success for played in episodes if shape in ("all", played.shape)]
        interval = wilson_interval(sum(chosen), len(chosen))
        bounds = f"[{100 * interval.low:.1f}, {100 * interval.high:.1f}]"
        print(f"{name} {shape}: {100 * np.mean(chosen):.1f} % {bounds} of {len(chosen)}")
    for what, lists in (
        ("part", [played.part_forces_n for played in episodes]),
        ("gel", [played.gel_forces_n for played in episodes]),
    ):
        peaks, highest = [max(forces) for forces in lists], [np.percentile(forces, 95) for forces in lists]
        print(
            f"{name} force on the {what} [N], medians of episodes: largest {np.median(peaks):.2f} "
            f"(of all {max(peaks):.1f}), 95th percentile {np.median(highest):.2f}"
        )


def main() -> None:
    """Play and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("submission", type=Path, nargs="?", default=EXAMPLE)
    parser.add_argument("--task", default="peg-insertion")
    parser.add_argument("--every", type=int, default=6)
    arguments = parser.parse_args()
    _, task = find_task(arguments.task)
    policy, flows = read_policy(arguments.submission), []
    for model in ContactModel:
        chosen = task.model_copy(update={"settings": task.settings | {"contact_model": str(model)}})
        env = make_environment(chosen, None, tuple(observable.name for observable in task.observables))
        episodes = [play(env, chosen, episode, policy) for episode in task.episodes[:: arguments.every]]
        print_rates(str(model), episodes)
        flows.append(np.array([played.flow[:, 1] - played.flow[:, 0] for played in episodes]))
    moved, changed = (np.sqrt((flow**2).sum(axis=-1).mean()) for flow in (flows[0], flows[1] - flows[0]))
    print(f"marker flow after the grasp: {moved:.2f} pixels, differs by {changed:.2f} between the models (both RMS)")


if __name__ == "__main__":
    main()
