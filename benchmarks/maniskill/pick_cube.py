"""Measures the evaluation of PickCube-v1 by state, and its env steps beside those of bare ManiSkill.

Run it as `python benchmarks/maniskill/pick_cube.py [--episodes 100] [--workers 2] [--rounds 20] [--json FILE]` where
the extra maniskill is installed. Episodes are played in the sandbox and bare, with the same actions, in turns: the
ratio of their times holds on a busy machine, too.
"""

import argparse
import json
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from statistics import median
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray
from vitac.evaluator.agent.session import PolicySession
from vitac.evaluator.episodes.episode import Environment, make_environment, run_episode
from vitac.evaluator.evaluation.local import evaluate
from vitac.evaluator.submission.staging import staged
from vitac.evaluator.tracks import find_task

EXAMPLE = Path(__file__).parents[2] / "examples" / "maniskill"
TASK = "pick-cube"


def main() -> None:
    """Compare env steps, then evaluate the list, and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--episodes", type=int, default=100)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--rounds", type=int, default=20)
    parser.add_argument("--json", type=Path, help="write the numbers to this file")
    arguments = parser.parse_args()
    with staged(EXAMPLE) as submission:
        numbers = compared(submission, rounds=arguments.rounds)
        if arguments.episodes:
            numbers |= evaluated(submission, episodes=arguments.episodes, workers=arguments.workers)
    for name, value in numbers.items():
        print(f"{name:26} {value:10.2f}")
    if arguments.json:
        arguments.json.write_text(json.dumps(numbers, indent=1) + "\n")


class TimedResets:
    """An environment that keeps how long its last reset took [s]."""

    def __init__(self, env: Environment) -> None:
        self._env = env
        self.reset_s = 0.0

    def __getattr__(self, name: str) -> Any:
        """Return what the environment has of that name."""
        return getattr(self._env, name)

    def reset(self, *, options: Mapping[str, object]) -> tuple[Mapping[str, NDArray[Any]], dict[str, Any]]:
        """Start an episode."""
        started = perf_counter()
        begun = self._env.reset(options=options)
        self.reset_s = perf_counter() - started
        return begun


def compared(submission: Path, *, rounds: int) -> dict[str, float]:
    """Return medians over episodes: env steps per second and resets [ms] in the sandbox and bare, and their ratio."""
    _, task = find_task(TASK)
    env, bare = TimedResets(make_environment(task)), bare_environment(task.settings)
    steps, bare_steps, resets, bare_resets = [], [], [], []
    with PolicySession(submission) as session:
        for episode in task.episodes[:rounds]:
            record = run_episode(env=env, task=task, episode=episode, open_session=partial(_same, session))
            if record.failure:
                raise SystemExit(record.failure.message)
            steps.append((record.timings.wall_s - env.reset_s) / record.env_steps)
            resets.append(env.reset_s)
            started = perf_counter()
            bare.reset(seed=episode.number, options={"reconfigure": True})
            bare_resets.append(perf_counter() - started)
            started = perf_counter()
            for action in record.actions.to_array():
                observation, *_ = bare.step(action)
                np.array(observation.cpu())
            bare_steps.append((perf_counter() - started) / record.env_steps)
    return {
        "steps_per_s": 1.0 / median(steps),
        "bare_steps_per_s": 1.0 / median(bare_steps),
        "step_ratio": median(ours / theirs for ours, theirs in zip(steps, bare_steps, strict=True)),
        "reset_ms": 1e3 * median(resets),
        "bare_reset_ms": 1e3 * median(bare_resets),
    }


def bare_environment(settings: Mapping[str, Any]) -> Any:
    """Return ManiSkill's own environment with the settings of the task; torch is set up by ours, made before."""
    import gymnasium

    control_mode = settings["control_mode"]
    made = gymnasium.make(
        "PickCube-v1", obs_mode="state", control_mode=control_mode, sim_backend="physx_cpu", render_backend="none"
    )
    return made.unwrapped


def evaluated(submission: Path, *, episodes: int, workers: int) -> dict[str, float]:
    """Return the time of an evaluation [s] and what it is made of, in CPU time [s]."""
    track, task = find_task(TASK)
    numbers = tuple(episode.number for episode in task.episodes[:episodes])
    started = perf_counter()
    evaluation = evaluate(submission_dir=submission, track=track, task=task, workers=workers, episodes=numbers)
    wall_s = perf_counter() - started
    timings = [record.timings for record in evaluation.records]
    return {
        "evaluation_s": wall_s,
        "evaluation_physics_cpu_s": sum(timing.physics_s for timing in timings),
        "evaluation_policy_cpu_s": sum(timing.policy_s for timing in timings),
        "evaluation_env_steps": float(sum(record.env_steps for record in evaluation.records)),
    }


def _same(session: PolicySession) -> PolicySession:
    return session


if __name__ == "__main__":
    main()
