"""Which episodes are for what: streams of random starts that no official list shares a number with.

An official episode is `rng_seed = (list seed, number)` at a given start. A stream's episodes have a seed of their own
and their starts are drawn, so that training sees no official episode; a stream with a list's seed is refused.
"""

from enum import IntEnum

from vitac.errors import VitacError
from vitac.evaluator.tracks import list_tracks, load_track

FIRST_STREAM = 1_000_000
"""Seeds of streams begin here; a list of a track may have any smaller seed."""
STREAMS_PER_SEED = 10


class StreamRefused(VitacError):
    """Episodes were asked for that an official list may hold, or that are for another use; choose another seed."""


class Use(IntEnum):
    """What the episodes of a stream are for; those that choose a network are not those that are reported."""

    COLLECT = 0
    """Episodes to learn from."""
    CHOOSE = 1
    """Held-out episodes by which the best round is chosen."""
    REPORT = 2
    """Episodes of the figures that are reported; nothing is chosen by them."""
    PLAY_BY_HAND = 3
    """Episodes that a person plays."""


def stream(seed: int, use: Use) -> int:
    """Return the seed of the stream of a training run with this seed.

    Raises:
        StreamRefused: the seed is negative, or an official list has that of the stream.
    """
    if seed < 0:
        raise StreamRefused(f"The seed is {seed}, expected 0 or more.")
    seed_of_stream = FIRST_STREAM + STREAMS_PER_SEED * seed + use
    refuse_official(seed_of_stream)
    return seed_of_stream


def refuse_official_streams(seed: int) -> None:
    """Refuse the seed of a training of whose streams an official list has one.

    Raises:
        StreamRefused: it is negative, or an official list has that of a stream.
    """
    for use in Use:
        stream(seed, use)


def refuse_official(seed: int) -> None:
    """Refuse a seed that is the list seed of a track.

    Raises:
        StreamRefused: it is.
    """
    for name in list_tracks():
        for task in load_track(name).tasks.values():
            if task.episode_list.list_seed == seed:
                raise StreamRefused(
                    f"Seed {seed} is that of the official list of {task.name} ({name}); training must not see its "
                    "episodes. Choose another seed."
                )
