"""Reads the demonstrations of a LeRobotDataset that `writing` wrote, exactly as they were collected."""

import json
from collections.abc import Iterator
from itertools import groupby
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np
from vitac.errors import VitacError
from vitac.evaluator.episodes.records import ActionSequence

from ...files import write_bytes
from ..collecting import FILE, Demonstration, Source, make_line
from ..frames import ORIGIN, NotOurs, Origin, StoredEpisode, read_origin
from .checking import check_lerobot
from .layout import INFO, STATE_HASH, Version, format_path


class DataSetBroken(VitacError):
    """A data set is not as it was written; `vitac data check` names all that is wrong."""


def import_lerobot(folder: Path, collections: Path) -> Path:
    """Write the file of the demonstrations of a data set, and return it.

    Args:
        folder: of the data set.
        collections: folder for the file, in a new folder named after the task.

    Raises:
        DataSetBroken: it is not as it was written.
        NotOurs: it was not written by `vitac data export`, or its table has other episodes than it says.
        NotSaved: the file cannot be written.
    """
    source, demonstrations = read_lerobot(folder)
    path = collections / source.manifest.task / FILE
    if path.exists():
        raise NotOurs(f"{path} is there already; expected a new folder. Name another one.")
    write_bytes(path, b"".join([make_line(source), *map(make_line, demonstrations)]))
    return path


def read_lerobot(folder: Path) -> tuple[Source, Iterator[Demonstration]]:
    """Return where the demonstrations of a data set come from, and them.

    Raises:
        DataSetBroken, NotOurs: as `import_lerobot`.
    """
    origin = read_origin(folder)
    fault = next(check_lerobot(folder), None)
    if fault is not None:
        raise DataSetBroken(f"{folder} is broken. {fault}")
    return origin.source, _read_all(folder, origin)


def _read_all(folder: Path, origin: Origin) -> Iterator[Demonstration]:
    episodes = groupby(_rows(folder), key=itemgetter("episode_index"))
    count = 0
    for stored, (_, rows) in zip(origin.episodes, episodes, strict=False):
        count += 1
        yield _demonstration(stored, list(rows))
    if count < len(origin.episodes) or next(episodes, None) is not None:
        raise NotOurs(f"{folder} has other episodes in its table than in {ORIGIN}; see `vitac data check {folder}`.")


def _rows(folder: Path) -> Iterator[dict[str, Any]]:
    """Yield the rows of the table, with the columns that are needed."""
    from pyarrow import parquet

    info = json.loads((folder / INFO).read_text())
    template = Version(info["codebase_version"]).data_path
    number = 0
    while (path := folder / format_path(template, number)).exists():
        yield from parquet.read_table(path, columns=["episode_index", "action", STATE_HASH]).to_pylist()
        number += 1


def _demonstration(stored: StoredEpisode, rows: list[dict[str, Any]]) -> Demonstration:
    actions = np.array([row["action"] for row in rows], dtype=np.float32)
    actions = actions.reshape(len(rows), -1)  # an action of one number is a column of numbers, as LeRobot has it
    return Demonstration(
        episode=stored.episode,
        kind=stored.kind,
        shape=stored.shape,
        outcome=stored.outcome,
        total_reward=stored.total_reward,
        actions=ActionSequence.from_array(actions),
        state_hashes=(*(row[STATE_HASH] for row in rows), stored.final_state_hash),
    )
