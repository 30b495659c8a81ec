"""Plays lock opening with a policy that `lerobot-train --policy.type=act` has learned, and counts its successes.

python play.py CHECKPOINT --vitac PYTHON [--blind] [--starts 100]

Runs in LeRobot's Python; the environment plays in PYTHON, that of `vitac`, since both need other packages. `--blind`
puts zeros in place of touch, for a policy that was trained so.
"""

import argparse
import os
import secrets
import subprocess
from collections.abc import Callable
from multiprocessing.connection import Connection, Listener
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

SERVE = Path(__file__).parents[1] / "another_python" / "serve.py"
STREAM = 7_000_000
"""Of the starts: no official list and no training has it."""
Act = Callable[[dict[str, NDArray[np.float32]]], NDArray[np.float32]]


def main() -> None:
    """Play the starts and print how many were solved."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("checkpoint", type=Path, help="folder pretrained_model of a checkpoint")
    parser.add_argument("--vitac", required=True, help="Python that has vitac")
    parser.add_argument("--blind", action="store_true")
    parser.add_argument("--starts", type=int, default=100)
    chosen = parser.parse_args()
    act, key = load_policy(chosen.checkpoint), secrets.token_hex(16)
    with Listener(authkey=key.encode()) as listener:
        command = [chosen.vitac, str(SERVE), str(listener.address), "ViTac/LockOpening-v1"]
        started = subprocess.Popen(command, env=os.environ | {"KEY": key})  # noqa: S603 - our own program
        with listener.accept() as environment:
            solved = [play(environment, act, number, is_blind=chosen.blind) for number in range(chosen.starts)]
        started.wait()
    print(f"{sum(solved)} of {len(solved)} solved: {''.join('.x'[each] for each in solved)}")


def load_policy(checkpoint: Path) -> Act:
    """Return what a checkpoint does with one observation."""
    import torch
    from lerobot.policies.act.modeling_act import ACTPolicy
    from lerobot.policies.factory import make_pre_post_processors

    policy = ACTPolicy.from_pretrained(checkpoint)
    before, after = make_pre_post_processors(policy.config, pretrained_path=str(checkpoint))

    def act(observed: dict[str, NDArray[np.float32]]) -> NDArray[np.float32]:
        policy.reset()  # a new chunk of actions at each env step
        with torch.inference_mode():
            chosen = after(policy.select_action(before({name: torch.from_numpy(x) for name, x in observed.items()})))
        return np.clip(chosen.squeeze(0).numpy(), -1.0, 1.0)

    return act


def play(environment: Connection, act: Act, number: int, *, is_blind: bool) -> bool:
    """Play an episode, and return whether it was solved."""
    environment.send(("reset", {"options": {"rng_seed": (STREAM, number)}}))
    observation, _ = environment.recv()
    terminated = truncated = False
    while not (terminated or truncated):
        environment.send(("step", {"action": act(observe(observation, is_blind=is_blind))}))
        observation, _, terminated, truncated, _ = environment.recv()
    return bool(terminated)


def observe(observation: dict[str, NDArray[Any]], *, is_blind: bool) -> dict[str, NDArray[np.float32]]:
    """Return what the data set of `vitac data export` has of an observation."""
    touch = np.concatenate([fit_motion(*gel) for gel in observation["marker_flow"]])
    return {
        "observation.state": observation["relative_motion"].astype(np.float32),
        "observation.environment_state": (0.0 * touch if is_blind else touch).astype(np.float32),
    }


def fit_motion(reference: NDArray[Any], current: NDArray[Any]) -> NDArray[np.float64]:
    """Fit the motion of a gel's markers by a mean and slopes over the picture; the last marker is repeated."""
    count = 1 + int(np.argmax((reference == reference[-1]).all(axis=1)))
    place = (reference[:count].astype(np.float64) - [160.0, 125.0]) / 100.0
    columns = np.column_stack([np.ones(count), place])
    return np.asarray(np.linalg.lstsq(columns, (current - reference)[:count].astype(np.float64), rcond=None)[0].ravel())


if __name__ == "__main__":
    main()
