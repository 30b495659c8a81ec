"""The organizers' lock episodes in our physics: do logged successes succeed, and at the logged env step? As JSON.

Usage: python benchmarks/reference/lock_log.py REFERENCE_DIR [--draws N] [--episodes N] [--generated-meshes]
       [--json FILE]

REFERENCE_DIR holds assets/track1 and logs/track1_open_lock.repeat0.jsonl. That log has the actions and results of 80
episodes, but not where the sensors gripped the key: every episode is played with several draws of that. One thread, no
GPU. `benchmarks/physics.md` says what the figures were.
"""

import argparse
import json
import sys
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
from vitac.envs.geometry.keys_and_locks import KeyShape, key_control_points
from vitac.envs.tasks.lock_opening.definition import SUCCESS_Z_RANGE_M
from vitac.envs.tasks.lock_opening.env import LockOpeningEnv, LockOpeningSettings

Episode = dict[str, Any]
LIST_SEED = 8


def main() -> None:
    """Play, print and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("reference_dir", type=Path)
    parser.add_argument("--draws", type=int, default=8)
    parser.add_argument("--episodes", type=int, default=80)
    parser.add_argument("--generated-meshes", action="store_true", help="ours, on which tracks are scored")
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    folder: Path = arguments.reference_dir
    env = LockOpeningEnv(assets_dir=None if arguments.generated_meshes else folder / "assets" / "track1")
    lines = (folder / "logs" / "track1_open_lock.repeat0.jsonl").read_text().splitlines()
    episodes: list[Episode] = [json.loads(line) for line in lines[: arguments.episodes]]
    played = [played_episode(env, episode, arguments.draws) for episode in episodes]
    text = json.dumps({**summary(played), "speed": speed(env)}, indent=1)
    sys.stdout.write(text + "\n")
    if arguments.json:
        arguments.json.write_text(text + "\n")


def played_episode(env: LockOpeningEnv, episode: Episode, draws: int) -> dict[str, Any]:
    """Return the episode's end with every draw, beside what the log says and what lifting alone would do."""
    return {
        "episode": episode["episode"],
        "key": episode["shape"],
        "offset_x_mm": episode["initial_offset"][0],
        "logged": {"success": episode["result"] == "SUCCESS", "env_steps": len(episode["steps"])},
        "lift_alone": find_lift(episode),
        "draws": [end(env, episode, draw) for draw in range(draws)],
    }


def end(env: LockOpeningEnv, episode: Episode, draw: int) -> dict[str, Any]:
    """Return how the logged actions end with one draw of the grip; `env_step` is None if they do not end it."""
    options = {"shape": episode["shape"], "offset_mm": tuple(episode["initial_offset"])}
    env.reset(options=options | {"rng_seed": (LIST_SEED + draw, episode["episode"])})
    for step in episode["steps"]:
        *_, terminated, truncated, info = env.step(np.array(step["action"], dtype=np.float32))
        if terminated or truncated:
            return {"end": info["end_reason"], "env_step": step["n"]}
    return {"end": None, "env_step": None}


def find_lift(episode: Episode) -> int | None:
    """Return the env step at which a key that follows the gripper exactly would stand high enough to succeed."""
    _, down_mm = LockOpeningSettings().action_scale_mm
    tooth_mm = 1e3 * key_control_points(KeyShape(episode["shape"])).rear_tooth_m[:, 2].max()
    heights_mm = tooth_mm - np.cumsum([down_mm * step["action"][1] for step in episode["steps"]])
    high = np.flatnonzero(heights_mm > 1e3 * SUCCESS_Z_RANGE_M[0])
    return int(high[0]) + 1 if len(high) else None


def summary(played: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the agreement on the logged successes, also by key; every draw of the logged failures."""
    solved = [episode for episode in played if episode["logged"]["success"]]
    return {
        "logged_successes": agreement(solved),
        "by_key": {
            str(key): agreement([episode for episode in solved if episode["key"] == key])
            for key in sorted({episode["key"] for episode in solved})
        },
        "logged_failures": [episode for episode in played if not episode["logged"]["success"]],
    }


def agreement(episodes: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the parts of the draws that succeed, at the logged env step and within one, and those of two guesses."""
    logged = [episode["logged"]["env_steps"] for episode in episodes]
    usual = Counter(logged).most_common(1)[0][0]
    ours = [
        draw["env_step"] - episode["logged"]["env_steps"] if draw["end"] == "success" else None
        for episode in episodes
        for draw in episode["draws"]
    ]
    return {
        "episodes": len(episodes),
        "draws": len(ours),
        "succeed": sum(late is not None for late in ours) / len(ours),
        **timing(ours),
        "env_steps_late": {str(late): count for late, count in sorted(Counter(ours).items(), key=str)},
        "guess_lift_alone": timing(
            [
                None if episode["lift_alone"] is None else episode["lift_alone"] - n
                for episode, n in zip(episodes, logged, strict=True)
            ]
        ),
        f"guess_always_{usual}": timing([usual - n for n in logged]),
    }


def timing(late: list[int | None]) -> dict[str, float]:
    """Return the parts that come exactly, and within one env step, when the log says."""
    return {
        "at_the_logged_env_step": sum(n == 0 for n in late) / len(late),
        "within_one": sum(n is not None and abs(n) <= 1 for n in late) / len(late),
    }


def speed(env: LockOpeningEnv) -> dict[str, float]:
    """Return the CPU time of the physics, building scenes included."""
    return {"ipc_steps": env.ipc_steps, "mean_ms_per_ipc_step": 1e3 * env.physics_cpu_s / env.ipc_steps}


if __name__ == "__main__":
    main()
