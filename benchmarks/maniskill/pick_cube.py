"""Measures the evaluation of PickCube-v1 by state, and its env steps beside those of bare ManiSkill.

Run it as `python benchmarks/maniskill/pick_cube.py [--episodes 100] [--workers 2] [--rounds 20] [--json FILE]` where
the extra maniskill is installed and nothing else runs. Episodes are played in the sandbox and bare, from the same
start with the same actions, in turns; the CPU time in the sandbox has the policy's in it.
"""

import argparse
import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from time import perf_counter, process_time
from typing import Any

import numpy as np
from numpy.typing import NDArray
from vitac.envs.maniskill.env import seed_of
from vitac.evaluator.agent.session import PolicySession
from vitac.evaluator.episodes.episode import Environment, Policy, make_environment, run_episode
from vitac.evaluator.episodes.records import EpisodeOutcome
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


class CountedSession:
    """A loaded policy whose CPU time in all its episodes so far can be asked for."""

    def __init__(self, session: PolicySession) -> None:
        self._session = session
        self._playing: Policy | None = None
        self._ended_s = 0.0

    def __getattr__(self, name: str) -> Any:
        """Return what the session has of that name."""
        return getattr(self._session, name)

    @property
    def cpu_s(self) -> float:
        """CPU time of the policy [s]."""
        return self._ended_s + (self._playing.cpu_s if self._playing else 0.0)

    @contextmanager
    def episode(self, **arguments: Any) -> Iterator[Policy]:
        """Give a fresh process of the policy, and count its time."""
        with self._session.episode(**arguments) as self._playing:
            yield self._playing
            self._ended_s, self._playing = self.cpu_s, None


class TimedEnvironment:
    """An environment that keeps the times of an episode, by the clock and of the CPU with the policy's [s], shape [2].

    Attributes:
        reset_s: of the reset.
        first_step_s: from there to the end of the first env step, before which the policy's process is started.
        steps_s: from there to the end of the last env step.
    """

    def __init__(self, env: Environment, policy: CountedSession) -> None:
        self._env = env
        self._policy = policy
        self._before = np.zeros(2)
        self.reset_s = self.first_step_s = self.steps_s = np.zeros(2)

    def __getattr__(self, name: str) -> Any:
        """Return what the environment has of that name."""
        return getattr(self._env, name)

    def reset(self, *, options: Mapping[str, object]) -> tuple[Mapping[str, NDArray[Any]], dict[str, Any]]:
        """Start an episode."""
        self._passed()
        begun = self._env.reset(options=options)
        self.reset_s, self.first_step_s, self.steps_s = self._passed(), np.zeros(2), np.zeros(2)
        return begun

    def step(self, action: NDArray[np.float32]) -> tuple[Any, ...]:
        """Play one env step, and count what has passed since the one before."""
        stepped: tuple[Any, ...] = self._env.step(action)
        if self.first_step_s.any():
            self.steps_s = self.steps_s + self._passed()
        else:
            self.first_step_s = self._passed()
        return stepped

    def _passed(self) -> NDArray[np.float64]:
        before, self._before = self._before, times(self._policy.cpu_s)
        return self._before - before


def times(policy_s: float = 0.0) -> NDArray[np.float64]:
    """Return the time by the clock, and the CPU time of this process and the policy [s]."""
    return np.array([perf_counter(), process_time() + policy_s])


def compared(submission: Path, *, rounds: int) -> dict[str, float]:
    """Return medians over episodes, in the sandbox and bare, by the clock, and ratios by the clock and of CPU time."""
    _, task = find_task(TASK)
    steps, bare_steps, resets, bare_resets, starts = [], [], [], [], []
    with PolicySession(submission) as loaded:
        session = CountedSession(loaded)
        env, bare = TimedEnvironment(make_environment(task), session), bare_environment(task.settings)
        for episode in task.episodes[:rounds]:
            record = run_episode(env=env, task=task, episode=episode, open_session=lambda: session)
            if record.failure:
                raise SystemExit(record.failure.message)
            steps.append(env.steps_s / (record.env_steps - 1))
            resets.append(env.reset_s)
            starts.append(env.first_step_s - steps[-1])
            began = times()
            bare.reset(seed=seed_of(task.env_id, episode.options), options={"reconfigure": True})
            was_reset = times()
            bare_resets.append(was_reset - began)
            for action in record.actions.to_array():
                observation, *_, info = bare.step(action)
                np.array(observation.cpu())
            bare_steps.append((times() - was_reset) / record.env_steps)
            if bool(info["success"]) != (record.outcome is EpisodeOutcome.SUCCESS):
                raise SystemExit(f"Episode {episode.number} went otherwise bare, so its times cannot be compared.")
    step_ratio, step_cpu_ratio = np.median(np.divide(steps, bare_steps), axis=0)
    return {
        "steps_per_s": 1.0 / float(np.median(steps, axis=0)[0]),
        "bare_steps_per_s": 1.0 / float(np.median(bare_steps, axis=0)[0]),
        "step_ratio": float(step_ratio),
        "step_cpu_ratio": float(step_cpu_ratio),
        "reset_ms": 1e3 * float(np.median(resets, axis=0)[0]),
        "bare_reset_ms": 1e3 * float(np.median(bare_resets, axis=0)[0]),
        "policy_start_ms": 1e3 * float(np.median(starts, axis=0)[0]),
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


if __name__ == "__main__":
    main()
