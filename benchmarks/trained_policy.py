"""Counts the successes of a trained policy from fresh starts, which neither taught it nor chose it.

python benchmarks/trained_policy.py examples/peg_insertion_trained/Track_1 [--starts 300] [--seed 1] [--public]
                                    [--task lock-opening] [--contact-model NAME] [--critic RUN] [--json FILE]

`--public` plays the public list instead, whose official score is that of `vitac evaluate`, in the sandbox. `--critic`
lets the best round's critic act, which sees the true offset: what is lost by sensing is the difference. The contact
model is by default that of the task. Episodes whose physics did not converge are listed.
"""

import argparse
import json
from collections.abc import Hashable, Iterable, Iterator, Mapping
from pathlib import Path
from runpy import run_path
from typing import Any

import numpy as np
from vitac.envs.fem.model.settings import ContactModel
from vitac.evaluator.episodes import episode
from vitac.evaluator.scoring.score import rate_by_start
from vitac.evaluator.scoring.starts import group_by_start
from vitac.evaluator.tracks import find_task
from vitac.training.collection import Networks, critic_actor
from vitac.training.episodes import TASK, TRUTHS, Actor, ActorInput, make_environment
from vitac.training.files import load
from vitac.training.learners import Learners
from vitac.training.learning.critic import Critic
from vitac.training.recipe import Recipe
from vitac.training.run import Folder, best, read_results
from vitac.training.streams import Use, stream
from vitac.training.submission.policy import History


def main() -> None:
    """Play the starts and print the rates."""
    parser = argparse.ArgumentParser(description="successes of a trained policy from fresh starts")
    parser.add_argument("submission", type=Path, help="folder with policy.py")
    parser.add_argument("--starts", type=int, default=300)
    parser.add_argument("--seed", type=int, default=1, help="of the training run")
    parser.add_argument("--task", default=TASK)
    parser.add_argument("--public", action="store_true", help="play the public list instead")
    parser.add_argument("--contact-model", choices=list(ContactModel))
    parser.add_argument("--critic", type=Path, help="folder of the run whose critic acts instead")
    parser.add_argument("--json", type=Path, help="write the figures to this file")
    chosen = parser.parse_args()
    policy: Any = (
        KnowsTruth(chosen.critic) if chosen.critic else run_path(str(chosen.submission / "policy.py"))["Policy"]()
    )
    starts = public_starts(chosen.task) if chosen.public else fresh_starts(chosen.seed, chosen.starts)
    world = {"contact_model": chosen.contact_model} if chosen.contact_model else {}
    env = (
        make_environment(**world)
        if chosen.critic
        else episode.make_environment(find_task(chosen.task)[1], settings=world)
    )
    found = {"starts": "public list" if chosen.public else f"stream {stream(chosen.seed, Use.REPORT)}"}
    found |= figures(env, policy, starts, chosen.task)
    print(json.dumps(found, indent=1))
    if chosen.json:
        chosen.json.write_text(json.dumps(found, indent=1) + "\n")


def fresh_starts(seed: int, count: int) -> Iterator[Mapping[str, Any]]:
    """Give the reset options of random starts of the stream for reports."""
    return ({"rng_seed": (stream(seed, Use.REPORT), number)} for number in range(count))


def public_starts(task: str = TASK) -> Iterator[Mapping[str, Any]]:
    """Give the reset options of the public list."""
    return (episode.options for episode in find_task(task)[1].episodes)


class KnowsTruth:
    """Plays as the critic of a run's best round does, which sees the truth.

    Args:
        folder: of the run.
    """

    def __init__(self, folder: Path) -> None:
        recipe = Recipe.model_validate(json.loads((folder / "run.json").read_text())["recipe"])
        kept = Folder(path=folder)
        learners = Learners(recipe, np.random.default_rng(0))
        learners.restore(load(kept.networks(best(read_results(kept)).number)))
        networks: Networks = learners.networks()
        critic = Critic.from_state(networks.plan, networks.critic)
        self._actor: Actor = critic_actor(critic, 0.0)(np.random.default_rng(0))

    def reset(self, task: str) -> None:
        """Begin an episode."""
        self._env_steps = 0

    def act(self, observation: Mapping[str, Any]) -> Any:
        """Return the action that the critic values most."""
        truth = np.concatenate([observation[key] for key in TRUTHS])
        moment = ActorInput(history=History(), truth=truth, shape=int(observation["shape"][0]), step=self._env_steps)
        self._env_steps += 1
        return self._actor(moment)


def figures(env: Any, policy: Any, starts: Iterator[Mapping[str, Any]], task: str = TASK) -> dict[str, Any]:
    """Return successes with their interval, also by shape, the mean env steps of successes, and how episodes ended."""
    rows = [{**played(env, policy, options, task), "start": dict(options)} for options in starts]
    shapes = sorted({row["shape"] for row in rows})
    by_shape = {shape: [row for row in rows if row["shape"] == shape] for shape in shapes}
    return {
        **rate_by_start(map(_ended, rows)).model_dump(exclude={"starts"}),
        "mean_steps": float(np.mean([row["env_steps"] for row in rows if row["end"] == "success"] or [0])),
        "by_shape": {
            shape: rate_by_start(map(_ended, of_shape)).model_dump() | {"solved_of_start": count_starts(of_shape)}
            for shape, of_shape in by_shape.items()
        },
        "ends": {end: sum(row["end"] == end for row in rows) for end in sorted({row["end"] for row in rows})},
        "not_converged": [row["start"] for row in rows if row["end"] == "not_converged"],
    }


def name_start(options: Mapping[str, Any]) -> Hashable:
    """Return the start that reset options ask for, which a list repeats with other seeds and a stream never."""
    own = {name: value for name, value in options.items() if name != "rng_seed"}
    return tuple((own or options).items())


def _ended(row: Mapping[str, Any]) -> tuple[Hashable, bool]:
    return name_start(row["start"]), row["end"] == "success"


def count_starts(rows: Iterable[Mapping[str, Any]]) -> list[int]:
    """Return of how many starts no repeat was solved, of how many one, and so on."""
    groups = group_by_start(map(_ended, rows))
    return [sum(sum(group) == solved for group in groups) for solved in range(max(map(len, groups)) + 1)]


def played(env: Any, policy: Any, options: Mapping[str, Any], task: str = TASK) -> dict[str, Any]:
    """Return the shape of an episode, how it ended, and after how many env steps."""
    observation, info = env.reset(options=options)
    policy.reset(task)
    while info["end_reason"] is None:
        observation, _, _, _, info = env.step(policy.act(observation))
    return {"shape": str(env.task_scene.shape), "end": info["end_reason"], "env_steps": info["steps"]}


if __name__ == "__main__":
    main()
