"""Measures the evaluation of PickCube-v1 by state, and its env steps beside those of bare ManiSkill.

Run it as `python benchmarks/maniskill/pick_cube.py [--episodes 100] [--workers 2] [--rounds 20] [--json FILE]` where
the extra maniskill is installed and nothing else runs. Each episode is played by the same policy in the sandbox and
bare, where it is called in the same process as ManiSkill; each way goes first every other time. Env steps after the
first are compared, by the clock and in CPU time with the policy's.
"""

import argparse
import json
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from time import perf_counter, process_time
from typing import Any

import numpy as np
from numpy.typing import NDArray
from vitac.envs.maniskill.env import compute_seed
from vitac.evaluator.agent.session import PolicySession
from vitac.evaluator.episodes.episode import PlayingPolicy, make_environment, run_episode
from vitac.evaluator.episodes.records import EpisodeOutcome, EpisodeRecord
from vitac.evaluator.evaluation.local import evaluate
from vitac.evaluator.submission.sources import staged
from vitac.evaluator.tracks import Episode, Task, find_task

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
        self._playing: PlayingPolicy | None = None
        self._ended_s = 0.0

    def __getattr__(self, name: str) -> Any:
        """Return what the session has of that name."""
        return getattr(self._session, name)

    @property
    def cpu_s(self) -> float:
        """CPU time of the policy [s]."""
        return self._ended_s + (self._playing.cpu_s if self._playing else 0.0)

    @contextmanager
    def episode(self, **arguments: Any) -> Iterator[PlayingPolicy]:
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

    def __init__(self, env: Any, policy_cpu_s: Callable[[], float]) -> None:
        self._env = env
        self._policy_cpu_s = policy_cpu_s
        self._before = np.zeros(2)
        self.reset_s = self.first_step_s = self.steps_s = np.zeros(2)

    def __getattr__(self, name: str) -> Any:
        """Return what the environment has of that name."""
        return getattr(self._env, name)

    def reset(self, **arguments: Any) -> Any:
        """Start an episode."""
        self._passed()
        begun = self._env.reset(**arguments)
        self.reset_s, self.first_step_s, self.steps_s = self._passed(), np.zeros(2), np.zeros(2)
        return begun

    def step(self, action: NDArray[np.float32]) -> Any:
        """Play one env step, and count what has passed since the one before."""
        stepped = self._env.step(action)
        if self.first_step_s.any():
            self.steps_s = self.steps_s + self._passed()
        else:
            self.first_step_s = self._passed()
        return stepped

    def _passed(self) -> NDArray[np.float64]:
        before, self._before = self._before, times(self._policy_cpu_s())
        return self._before - before


def times(policy_s: float) -> NDArray[np.float64]:
    """Return the time by the clock, and the CPU time of this process and the policy [s]."""
    return np.array([perf_counter(), process_time() + policy_s])


class BarePlay:
    """Plays a task in ManiSkill's own environment, with the example's policy in this process.

    Attributes:
        env: counts times; the policy's are in those of this process.
        actions: of the last episode, shape [env steps, 4].
        succeeded: whether the last episode was a success.
    """

    def __init__(self, task: Task) -> None:
        sys.path.insert(0, str(EXAMPLE / "ManiSkill"))
        from policy import Policy as Example

        self._task = task
        self._make_policy: Callable[[], Any] = Example
        self.env = TimedEnvironment(bare_environment(task.settings), lambda: 0.0)

    def play(self, episode: Episode) -> None:
        """Play an episode to its end."""
        actions: list[NDArray[np.float32]] = []
        policy, self.succeeded = self._make_policy(), False
        policy.reset(self._task.name)
        seed = compute_seed(self._task.env_id, episode.options)
        observation, _ = self.env.reset(seed=seed, options={"reconfigure": True})
        while not self.succeeded and len(actions) < self._task.max_steps:
            actions.append(policy.act({"state": np.array(observation.cpu())[0]}))
            observation, *_, info = self.env.step(actions[-1])
            self.succeeded = bool(info["success"])
        self.actions = np.array(actions)


def compared(submission: Path, *, rounds: int) -> dict[str, float]:
    """Return medians over episodes, in the sandbox and bare, by the clock, and ratios by the clock and of CPU time."""
    _, task = find_task(TASK)
    steps, bare_steps, resets, bare_resets, starts = [], [], [], [], []
    with PolicySession(submission) as loaded:
        session = CountedSession(loaded)
        env = TimedEnvironment(make_environment(task), lambda: session.cpu_s)
        bare = BarePlay(task)
        for turn, episode in enumerate(task.episodes[:rounds]):
            if turn % 2:
                bare.play(episode)
            record = run_episode(env=env, task=task, episode=episode, open_session=lambda: session)
            if not turn % 2:
                bare.play(episode)
            require_equal(record, bare)
            later_steps = record.env_steps - 1
            steps.append(env.steps_s / later_steps)
            bare_steps.append(bare.env.steps_s / later_steps)
            resets.append(env.reset_s)
            bare_resets.append(bare.env.reset_s)
            starts.append(env.first_step_s - bare.env.first_step_s)
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


def require_equal(record: EpisodeRecord, bare: BarePlay) -> None:
    """Make sure that an episode was the same in the sandbox and bare, so that its times can be compared."""
    if record.failure:
        raise SystemExit(record.failure.message)
    if not np.array_equal(record.actions.to_array(), bare.actions):
        raise SystemExit(f"Episode {record.episode} had other actions bare, so its times cannot be compared.")
    if bare.succeeded != (record.outcome is EpisodeOutcome.SUCCESS):
        raise SystemExit(f"Episode {record.episode} ended otherwise bare, so its times cannot be compared.")


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
