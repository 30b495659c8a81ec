"""Writes demonstrations as a data set of Minari; needs the extra `data`."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from .card import LICENCE
from .demonstration import Source
from .frames import Frames


def write_minari(folder: Path, source: Source, env: Any, frames: Iterator[Frames]) -> None:
    """Write a data set, which `minari.MinariDataset(folder / "data")` reads.

    Coloured pictures are stored as JPEG; all other values exactly. Infos hold the state hashes.
    """
    import minari
    from minari.dataset.minari_storage import MinariStorage

    task = source.manifest.task
    storage = MinariStorage.new(
        folder / "data", observation_space=env.observation_space, action_space=env.action_space, env_spec=env.spec
    )
    storage.update_metadata(
        {
            "dataset_id": f"vitac/{task}/expert-v0",
            "minari_version": minari.__version__,
            "algorithm_name": "expert with privileged state",
            "author": {"ViTac Arena"},
            "description": f"Demonstrations of {task}, licence {LICENCE}; README.md is their card.",
        }
    )
    storage.update_episodes(_buffer(source, number, each) for number, each in enumerate(frames))


def _buffer(source: Source, number: int, frames: Frames) -> Any:
    from minari.data_collector import EpisodeBuffer

    demonstration, length = frames.demonstration, len(frames.actions)
    is_success = demonstration.is_success
    return EpisodeBuffer(
        id=number,
        options={"rng_seed": [source.stream, demonstration.episode]},
        observations=frames.observations,
        actions=frames.actions,
        rewards=frames.rewards.tolist(),
        terminations=[is_success and step == length - 1 for step in range(length)],
        truncations=[not is_success and step == length - 1 for step in range(length)],
        infos={"state_hash": list(demonstration.state_hashes)},
    )
