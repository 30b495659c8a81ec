"""Measures what a policy can tell its next episode by ending an episode at an instant of its choice.

Run it as `python benchmarks/clock_channel.py [--episodes 120] [--window 1.0] [--period 0]`. In each episode the policy
notes the time, and then ends at a random instant within the window; the scene of the next episode is built meanwhile,
as in an evaluation. `bits` is the mutual information between that instant and the time that the next episode reads
(Vasicek's estimate of the entropy of their difference); `bits_by_chance` the same with the pairs shuffled. What else
the machine does hides some of them: `bits_when_idle` are those that the CPU time of building scenes leaves, without a
period. Whoever waits twice as long tells one bit more.
"""

import argparse
import math
import tempfile
import time
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from vitac.evaluator.agent.session import PolicySession
from vitac.evaluator.episodes.episode import make_environment
from vitac.evaluator.tracks import find_task

POLICY = """
import time


class Policy:
    def reset(self, task):
        self.begin = time.time()

    def act(self, observation):
        window, instant = observation["window"][0], observation["instant"][0]
        end = self.begin - self.begin % window + instant
        end += window * (end < time.time())
        time.sleep(max(0.0, end - time.time()))
        return [self.begin % window / window]
"""


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--task", default="peg-insertion")
    parser.add_argument("--episodes", type=int, default=120)
    parser.add_argument("--window", type=float, default=1.0, help="longest wait of an episode [s]")
    parser.add_argument("--period", type=float, default=0.0, help="VITAC_EPISODE_PERIOD_S of the worker [s]")
    arguments = parser.parse_args()
    generator = np.random.default_rng()
    said = generator.random(arguments.episodes)
    heard, scenes_s = play(arguments.task, said * arguments.window, arguments.window, arguments.period)
    heard, said = heard[1:], said[:-1]
    print(f"{'bits':16} {bits((heard - said) % 1.0):6.2f}")
    print(f"{'bits_by_chance':16} {bits((heard - generator.permutation(said)) % 1.0):6.2f}")
    print(f"{'bits_when_idle':16} {bits(scenes_s[1:] / arguments.window % 1.0):6.2f}")


def play(
    name: str, instants_s: NDArray[np.float64], window_s: float, period_s: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return when in the window each episode began, as its policy reads the clock, and what its scene took of CPU."""
    _, task = find_task(name)
    env = make_environment(task)
    heard, scenes_s = [], []
    with tempfile.TemporaryDirectory(prefix="vitac-benchmark-") as name:
        Path(name).chmod(0o755)
        (Path(name) / "policy.py").write_text(POLICY)
        with PolicySession(Path(name), episode_period_s=period_s) as session:
            for number, instant_s in enumerate(instants_s):
                begun_s = time.process_time()
                env.reset(options=task.episodes[number % len(task.episodes)].options)
                scenes_s.append(time.process_time() - begun_s)
                with session.episode(task=task.name, action_shape=(1,)) as policy:
                    question = {"window": np.array([window_s]), "instant": np.array([instant_s])}
                    heard.append(float(policy.act(question)[0]))
    return np.array(heard), np.array(scenes_s)


def bits(differences: NDArray[np.float64]) -> float:
    """Return how far the entropy of differences on a circle of length 1 is below that of the uniform distribution.

    Vasicek's estimate (A test for normality based on sample entropy, 1976, equation 2) with spacings of sqrt(n).
    """
    n = len(differences)
    m = round(math.sqrt(n))
    in_order = np.sort(differences)
    spacings = np.concatenate([in_order[m:], in_order[:m] + 1.0]) - in_order
    return float(-np.mean(np.log2(np.maximum(spacings, 1e-9) * n / m)))


if __name__ == "__main__":
    main()
