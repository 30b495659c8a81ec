"""CPU time of an IPC step under both contact models, with the same actions, in turn.

Usage: python benchmarks/contact/cost.py [--every 3]

The heuristic of each of peg insertion and lock opening plays every N-th public episode under challenge-2025; then its
actions are played under both models, episode by episode, so that a machine that slows down slows both. Prints the
time of the physics per IPC step and the ratio, over all steps and as the median of episodes.
"""

import argparse
import sys
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from contact.models import find_policy, read_policy
from numpy.typing import NDArray
from vitac.envs.fem.model.settings import ContactModel
from vitac.evaluator.episodes.episode import make_environment
from vitac.evaluator.tracks import Episode, Task, find_task


def made(task: Task, model: ContactModel) -> Any:
    """Return the environment of a task under a contact model."""
    chosen = task.model_copy(update={"settings": task.settings | {"contact_model": str(model)}})
    return make_environment(chosen, None, ("relative_motion", "marker_flow"))


def chosen_actions(env: Any, task: Task, episode: Episode, policy: Any) -> list[NDArray[np.float32]]:
    """Play an episode with a policy and return its actions."""
    observation, _ = env.reset(options=episode.options)
    policy.reset(task.name)
    actions: list[NDArray[np.float32]] = []
    for _ in range(task.max_steps):
        actions.append(np.clip(np.asarray(policy.act(observation), dtype=np.float32), -1, 1))
        observation, *_, info = env.step(actions[-1])
        if info["end_reason"] is not None:
            break
    return actions


def played_ms(env: Any, episode: Episode, actions: list[NDArray[np.float32]]) -> tuple[float, int]:
    """Play actions; return the CPU time of the physics [ms] and the IPC steps, without those of the reset."""
    env.reset(options=episode.options)
    began_s, steps_before = env._clocks.physics.elapsed_s, env.ipc_steps
    for action in actions:
        *_, info = env.step(action)
        if info["end_reason"] == "not_converged":
            break
    return 1e3 * (env._clocks.physics.elapsed_s - began_s), env.ipc_steps - steps_before


def compare_cost(name: str, every: int) -> None:
    """Print the cost of one heuristic's actions under both models."""
    task_name, folder = find_policy(name)
    _, task = find_task(task_name)
    policy = read_policy(folder)
    envs = {model: made(task, model) for model in ContactModel}
    costs: dict[ContactModel, list[tuple[float, int]]] = {model: [] for model in ContactModel}
    for episode in task.episodes[::every]:
        actions = chosen_actions(envs[ContactModel.CHALLENGE_2025], task, episode, policy)
        for model, env in envs.items():
            costs[model].append(played_ms(env, episode, actions))
    old, new = (np.array(costs[model]) for model in ContactModel)
    means = [float(cost[:, 0].sum() / cost[:, 1].sum()) for cost in (old, new)]
    each = (new[:, 0] / new[:, 1]) / (old[:, 0] / old[:, 1])
    print(
        f"{task_name}: {means[0]:.2f} ms per IPC step under challenge-2025, {means[1]:.2f} ms under arena-2: "
        f"{means[1] / means[0]:.2f} times, median of {len(each)} episodes {np.median(each):.2f}"
    )


def main() -> None:
    """Play and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--every", type=int, default=3)
    arguments = parser.parse_args()
    for name in ("peg_insertion_heuristic", "lock_opening_heuristic"):
        compare_cost(name, arguments.every)


if __name__ == "__main__":
    main()
