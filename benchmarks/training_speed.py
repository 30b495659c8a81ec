"""Where the time of data for training goes: resets against env steps, and env steps per second of a vector environment.

python benchmarks/training_speed.py [--envs 8] [--episodes 30] [--env-steps 100] [--fidelity training]

CPU times are of one process with random actions. The rate of the vector environment needs an idle machine.
"""

import argparse
from dataclasses import dataclass
from time import perf_counter, process_time
from typing import Any

import gymnasium
import numpy as np
import vitac.envs

KEYS = ("marker_flow", "relative_motion")


@dataclass(kw_only=True)
class Share:
    """CPU time of one kind of call.

    Attributes:
        calls: how many.
        cpu_s: of all of them [s].
        ipc_steps: that were solved in them.
    """

    calls: int = 0
    cpu_s: float = 0.0
    ipc_steps: int = 0

    def sentence(self) -> str:
        """Return one line for people."""
        return f"{1e3 * self.cpu_s / self.calls:6.1f} ms with {self.ipc_steps / self.calls:.1f} IPC steps"


def shares(env_id: str, episodes: int, fidelity: str) -> tuple[Share, Share]:
    """Return the CPU times of resets and of env steps with random actions."""
    made = gymnasium.make(env_id, disable_env_checker=True, observation_keys=KEYS, fidelity=fidelity)
    env: Any = made.unwrapped
    env.reset(seed=0)
    env.step(np.zeros(env.action_space.shape, dtype=np.float32))
    reset, step = Share(), Share()
    random = np.random.default_rng(0)
    for number in range(episodes):
        timed(env, reset, lambda number=number: env.reset(seed=number))
        ended = False
        while not ended:
            action = random.uniform(-1, 1, env.action_space.shape).astype(np.float32)
            _, _, terminated, truncated, _ = timed(env, step, lambda action=action: env.step(action))
            ended = terminated or truncated
    return reset, step


def timed(env: Any, share: Share, call: Any) -> Any:
    """Add a call to the share of its kind."""
    before_s, before = process_time(), env.ipc_steps
    result = call()
    share.calls += 1
    share.cpu_s += process_time() - before_s
    share.ipc_steps += env.ipc_steps - before
    return result


def vector_rate(env_id: str, envs: int, env_steps: int, fidelity: str) -> float:
    """Return the env steps per second of a vector environment, those that reset an episode not counted."""
    vector: Any = gymnasium.make_vec(env_id, envs, observation_keys=KEYS, fidelity=fidelity)
    vector.reset(seed=0)
    random, played, started = np.random.default_rng(0), 0, perf_counter()
    for _ in range(env_steps):
        info = vector.step(random.uniform(-1, 1, vector.action_space.shape).astype(np.float32))[4]
        played += int((info["steps"] > 0).sum())
    rate = played / (perf_counter() - started)
    vector.close()
    return rate


def main() -> None:
    """Print a few lines for each task of Track 1."""
    parser = argparse.ArgumentParser(description="where the time of data for training goes")
    parser.add_argument("--envs", type=int, default=8)
    parser.add_argument("--episodes", type=int, default=30)
    parser.add_argument("--env-steps", type=int, default=100)
    parser.add_argument("--fidelity", default="full", help="full or training")
    chosen = parser.parse_args()
    for env_id in sorted(vitac.envs.ENVIRONMENTS):
        reset, step = shares(env_id, chosen.episodes, chosen.fidelity)
        rate = vector_rate(env_id, chosen.envs, chosen.env_steps, chosen.fidelity)
        print(env_id)
        print(f"  reset    {reset.sentence()}")
        print(f"  env step {step.sentence()}, {step.calls / chosen.episodes:.1f} per episode")
        print(f"  {step.calls / (reset.cpu_s + step.cpu_s):.0f} env steps per CPU second, resets included")
        print(f"  {rate:.0f} env steps per second in {chosen.envs} forked processes")


if __name__ == "__main__":
    main()
