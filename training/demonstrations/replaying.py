"""Plays stored demonstrations again and compares every state with its hash."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ..pool import map_in_order
from .collecting import FILE, Demonstration, Source, read_demonstrations, read_source
from .frames import make_observed_environment, play_again
from .lerobot.reading import read_lerobot


def read_folder(folder: Path) -> tuple[Source, list[Demonstration]]:
    """Return the demonstrations of a folder of `vitac data collect`, or of a LeRobotDataset made of one.

    Raises:
        CollectionRejected: a line is not what was written.
        NotOurs: it is neither.
    """
    if (folder / FILE).exists():
        return read_source(folder / FILE), list(read_demonstrations(folder / FILE))
    source, demonstrations = read_lerobot(folder)
    return source, list(demonstrations)


def replay(
    source: Source,
    demonstrations: Sequence[Demonstration],
    *,
    count: int,
    seed: int = 0,
    processes: int = 1,
    report: Callable[[int], None],
) -> Mapping[int, Mapping[str, Any]]:
    """Play some demonstrations again, and return the last info of each by its episode.

    Args:
        source: where they come from.
        demonstrations: of which they are drawn.
        count: how many; all if there are not more.
        seed: by which they are drawn.
        processes: that play.
        report: called with the number of episodes so far.

    Raises:
        DemonstrationDiffers: one has another state.
    """
    order = np.random.default_rng(seed).permutation(len(demonstrations))[:count]
    env = make_observed_environment(source.task, ())
    played = map_in_order(partial(play_again, env, source), [demonstrations[number] for number in order], processes)
    last_infos = {}
    for number, frames in enumerate(played, start=1):
        last_infos[frames.demonstration.episode] = frames.last_info
        report(number)
    return last_infos
