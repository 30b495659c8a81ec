"""State hashes of fixed episodes, pinned per solver version; run as a script to pin those of the present solver."""

import json
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import vitac.envs  # noqa: F401 - registers the ids
from vitac.envs.fem import SOLVER_VERSION

PINNED = Path(__file__).resolve().parents[2] / "contract" / "golden_states.json"
EPISODES: dict[str, dict[str, Any]] = {
    "peg cuboid": {
        "env_id": "ViTac/PegInsertion-v1",
        "options": {"shape": "cuboid", "offset_mm_deg": (-4, -4, -8), "rng_seed": (0, 1)},
        "actions": [(0.05, 0.9, 0.03), (0.9, 0.8, 1.0)],
    },
    "peg trapezoid": {
        "env_id": "ViTac/PegInsertion-v1",
        "options": {"shape": "trapezoid", "offset_mm_deg": (1, 3, 0), "rng_seed": (0, 2)},
        "actions": [(-0.3, -0.6, 0.1), (0.0, -0.6, 0.0)],
    },
    "peg concave1": {
        "env_id": "ViTac/PegInsertion-v1",
        "options": {"shape": "concave1", "offset_mm_deg": (2, -1, 4), "rng_seed": (0, 3)},
        "actions": [(-0.8, 0.4, -0.7), (0.0, 0.0, 0.0)],
    },
    "lock key1": {
        "env_id": "ViTac/LockOpening-v1",
        "options": {"shape": "key1", "offset_mm": (0, 0, 0), "sensor_jitter_mm": (1.5, -1), "rng_seed": (0, 5)},
        "actions": [(-0.5, -1.0), (0.25, -0.75)],
    },
    "lock key2": {
        "env_id": "ViTac/LockOpening-v1",
        "options": {"shape": "key2", "offset_mm": (1, 0, 0), "sensor_jitter_mm": (0, 0), "rng_seed": (0, 4)},
        "actions": [(-1.0, -1.0), (-1.0, -0.3)],
    },
    "lock key3": {
        "env_id": "ViTac/LockOpening-v1",
        "options": {"shape": "key3", "offset_mm": (4.75, 0, 0), "sensor_jitter_mm": (-2, 2), "rng_seed": (0, 6)},
        "actions": [(-1.0, -1.0), (-1.0, -0.5)],
    },
    "lock key4": {
        "env_id": "ViTac/LockOpening-v1",
        "options": {"shape": "key4", "offset_mm": (2.5, 0, 0), "sensor_jitter_mm": (0.5, 0.5), "rng_seed": (0, 7)},
        "actions": [(0.5, -1.0), (-0.25, -0.5)],
    },
    "fusion hexagon": {
        "env_id": "ViTac/FusionInsertion-v1",
        "options": {"start": (3, 4, -7, 0.5, 1), "rng_seed": (0, 8)},
        "actions": [(0.2, 1.0, 0.5, -1.0), (1.0, -0.3, 1.0, -1.0)],
    },
    "fusion cuboid": {
        "env_id": "ViTac/FusionInsertion-v1",
        "options": {"start": (-1, -2, 5, 0.25, 0), "rng_seed": (0, 9)},
        "actions": [(-0.5, -0.5, -1.0, -1.0), (0.0, -1.0, 0.0, -0.6)],
    },
}


def state_hashes(episode: dict[str, Any]) -> list[str]:
    """Hashes after the reset and after every env step."""
    env: Any = gymnasium.make(episode["env_id"], disable_env_checker=True).unwrapped
    env.reset(options=episode["options"])
    hashes = [env.state_hash()]
    for action in episode["actions"]:
        env.step(np.array(action, dtype=np.float32))
        hashes.append(env.state_hash())
    return hashes


def main() -> None:
    """Write the hashes of the present solver."""
    pinned = {name: state_hashes(episode) for name, episode in EPISODES.items()}
    PINNED.write_text(json.dumps({"solver_version": SOLVER_VERSION, "state_hashes": pinned}, indent=1) + "\n")


if __name__ == "__main__":
    main()
