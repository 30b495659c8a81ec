"""Measures the cost of isolating a policy: session start, one action, one episode, without simulation.

Run it as `python benchmarks/agent.py [--episodes 270] [--actions 8] [--json FILE]`.
"""

import argparse
import json
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from statistics import median
from time import perf_counter

import numpy as np
from vitac.evaluator.agent.session import PolicySession

OBSERVATION = {
    "marker_flow": np.zeros((2, 2, 128, 2), dtype=np.float32),
    "relative_motion": np.zeros(4, dtype=np.float32),
}
POLICY = """
import numpy as np


class Policy:
    def reset(self, task):
        pass

    def act(self, observation):
        return np.zeros(3, dtype=np.float32)
"""


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--episodes", type=int, default=270)
    parser.add_argument("--actions", type=int, default=8)
    parser.add_argument("--json", type=Path, help="write the numbers to this file")
    arguments = parser.parse_args()
    with submission() as folder:
        numbers = measure(folder, episodes=arguments.episodes, actions=arguments.actions)
    for name, value in numbers.items():
        print(f"{name:28} {value:10.3f}")
    if arguments.json:
        arguments.json.write_text(json.dumps(numbers, indent=1) + "\n")


@contextmanager
def submission() -> Iterator[Path]:
    """Return the folder of a policy without motion, readable by the sandbox's user."""
    with tempfile.TemporaryDirectory(prefix="vitac-benchmark-") as name:
        folder = Path(name)
        folder.chmod(0o755)
        (folder / "policy.py").write_text(POLICY)
        yield folder


def measure(folder: Path, *, episodes: int, actions: int) -> dict[str, float]:
    """Return median times of starts, actions and episodes [ms] and the total time [s]."""
    starts_s = [start(folder) for _ in range(5)]
    action_s: list[float] = []
    episode_s: list[float] = []
    started = perf_counter()
    with PolicySession(folder) as session:
        for _ in range(episodes):
            before, acted = perf_counter(), len(action_s)
            play(session, actions, action_s)
            episode_s.append(perf_counter() - before - sum(action_s[acted:]))
    return {
        "start_ms": median(starts_s) * 1e3,
        "action_ms": median(action_s) * 1e3,
        "episode_without_actions_ms": median(episode_s) * 1e3,
        "all_s": perf_counter() - started,
    }


def start(folder: Path) -> float:
    """Return the time until a policy is loaded [s]."""
    before = perf_counter()
    with PolicySession(folder):
        return perf_counter() - before


def play(session: PolicySession, actions: int, action_s: list[float]) -> None:
    """Run one episode and append the time of each action [s]."""
    with session.episode(task="peg-insertion", action_shape=(3,)) as policy:
        for _ in range(actions):
            before = perf_counter()
            policy.act(OBSERVATION)
            action_s.append(perf_counter() - before)


if __name__ == "__main__":
    main()
