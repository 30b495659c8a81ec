"""An episode list is always cut at the same places, whichever of its episodes are wanted."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from vitac.evaluator.tracks import load_track
from vitac.evaluator.tracks.definition import ShardEpisodes, UnknownEpisodes, cut

TASK = load_track("track_1").tasks["peg-insertion"]
COUNT = len(TASK.episodes)
NUMBERS = st.sets(st.integers(1, COUNT), min_size=1)


def numbers_in(shard: ShardEpisodes) -> list[int]:
    return [episode.number for episode in shard.episodes]


def test_the_whole_list_is_cut_into_neighbours() -> None:
    shards = cut(TASK)
    assert [shard.index for shard in shards] == list(range(len(shards)))
    assert [number for shard in shards for number in numbers_in(shard)] == list(range(1, COUNT + 1))
    assert {len(shard.episodes) for shard in shards[:-1]} == {TASK.shard_size}
    assert 1 <= len(shards[-1].episodes) <= TASK.shard_size


@pytest.mark.parametrize("size", [1, 7, COUNT - 1, COUNT, COUNT + 1])
def test_the_last_shard_has_what_is_left(size: int) -> None:
    shards = cut(TASK.model_copy(update={"shard_size": size}))
    assert len(shards) == -(-COUNT // size)
    assert len(shards[-1].episodes) == COUNT - size * (len(shards) - 1)


@given(NUMBERS)
def test_wanted_episodes_stay_in_the_shards_that_they_have_in_the_whole_list(wanted: set[int]) -> None:
    whole = {shard.index: shard for shard in cut(TASK)}
    shards = cut(TASK, wanted)
    assert sorted(wanted) == [number for shard in shards for number in numbers_in(shard)]
    for shard in shards:
        assert shard.numbers == whole[shard.index].numbers & wanted
        assert set(shard.episodes) <= set(whole[shard.index].episodes)


@given(NUMBERS)
def test_the_order_and_the_repeats_of_what_is_wanted_change_nothing(wanted: set[int]) -> None:
    assert cut(TASK, [*wanted, *sorted(wanted, reverse=True)]) == cut(TASK, wanted)


def test_wanted_episodes_may_be_read_once_only() -> None:
    assert cut(TASK, iter([3, 1])) == cut(TASK, [1, 3])


@pytest.mark.parametrize(
    ("wanted", "got"),
    [
        ([0], "0"),
        ([COUNT + 1], str(COUNT + 1)),
        ([-1, 1], "-1"),
        ([1, 2, 900, 800], "800, 900"),
        (range(1000, 1010), "1000, 1001, 1002, 1003, 1004"),
        ([], "none"),
    ],
)
def test_episodes_that_the_list_lacks_are_named_up_to_five(wanted: list[int], got: str) -> None:
    with pytest.raises(UnknownEpisodes) as refused:
        cut(TASK, wanted)
    assert str(refused.value) == f"Expected episodes of peg-insertion from 1 to {COUNT}, got {got}."
