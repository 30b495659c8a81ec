"""Training sees no official episode."""

from itertools import product

import pytest
from vitac.evaluator.tracks import list_tracks, load_track
from vitac.training.streams import FIRST_STREAM, STREAMS_PER_SEED, StreamRefused, Use, refuse_official, stream

OFFICIAL = {task.episode_list.list_seed for name in list_tracks() for task in load_track(name).tasks.values()}


def test_no_stream_has_the_seed_of_an_official_list() -> None:
    seeds = {stream(seed, use) for seed, use in product(range(200), Use)}
    assert OFFICIAL
    assert not seeds & OFFICIAL
    assert min(seeds) >= FIRST_STREAM > max(OFFICIAL)


def test_every_seed_and_use_has_a_stream_of_its_own() -> None:
    seeds = [stream(seed, use) for seed, use in product(range(50), Use)]
    assert len(set(seeds)) == len(seeds)
    assert len(Use) <= STREAMS_PER_SEED


@pytest.mark.parametrize("seed", sorted(OFFICIAL))
def test_official_lists_are_refused_by_name(seed: int) -> None:
    with pytest.raises(StreamRefused, match=rf"Seed {seed} is that of the official list of .* Choose another seed"):
        refuse_official(seed)


def test_official_list_among_the_streams_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("vitac.training.streams.FIRST_STREAM", min(OFFICIAL))
    with pytest.raises(StreamRefused, match="official list"):
        stream(0, Use.COLLECT)


def test_negative_seed_is_refused() -> None:
    with pytest.raises(StreamRefused, match="The seed is -1, expected 0 or more"):
        stream(-1, Use.REPORT)
