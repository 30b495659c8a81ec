from typing import Any

import numpy as np
import pytest
from evaluation_records import make_manifest, make_record
from vitac.evaluator.episodes.records import ActionSequence, EpisodeOutcome, EpisodeRecord
from vitac.evaluator.logs.comparison import LogDifference, first_difference
from vitac.evaluator.logs.log import LogHeader

HEADER = LogHeader(team="Touch", manifest=make_manifest())
RECORDS = [make_record(1), make_record(2), make_record(3)]


def difference(
    records: list[EpisodeRecord] = RECORDS, header: LogHeader = HEADER
) -> tuple[int | None, int | None, str] | None:
    found = first_difference((HEADER, RECORDS), (header, records))
    return (found.episode, found.env_step, found.key) if found else None


def with_second(**changes: Any) -> list[EpisodeRecord]:
    return [RECORDS[0], make_record(2, **changes), RECORDS[2]]


def test_equal_logs_have_none_whoever_made_them() -> None:
    assert difference() is None
    assert difference(header=LogHeader(team="Others", submission_digest="d", manifest=make_manifest())) is None


def test_header_is_compared_first() -> None:
    other = LogHeader(manifest=make_manifest(solver_version="2"))
    assert difference([], other) == (None, None, "solver_version")


@pytest.mark.parametrize(
    ("records", "expected"),
    [
        (with_second(state_hashes=(*RECORDS[1].state_hashes[:2], "f" * 64, "e" * 64)), (2, 2, "state_hash")),
        (with_second(state_hashes=("f" * 64, *RECORDS[1].state_hashes[1:])), (2, 0, "state_hash")),
        (with_second(actions=ActionSequence.from_array(np.zeros((3, 3), np.float32))), (2, 1, "action")),
        (with_second(shape="cuboid"), (2, None, "shape")),
        (with_second(env_steps=4), (2, 4, "env_steps")),
        (with_second(outcome=EpisodeOutcome.STEPS), (2, None, "outcome")),
        (with_second(picture={"env_step": 1, "sha256": "a" * 64}), (2, None, "picture")),
        (RECORDS[:2], (3, None, "episode")),
        (RECORDS[1:], (1, None, "episode")),
        ([*RECORDS, make_record(4)], (4, None, "episode")),
    ],
)
def test_first_difference_is_named(records: list[EpisodeRecord], expected: tuple[int | None, int | None, str]) -> None:
    found = difference(records)
    other_way = first_difference((HEADER, records), (HEADER, RECORDS))
    assert found is not None
    assert other_way is not None
    assert (other_way.episode, other_way.env_step, other_way.key) == found
    assert (found[0], found[2]) == (expected[0], expected[2])
    if expected[2] != "env_steps":
        assert found[1] == expected[1]


def test_both_values_are_shown() -> None:
    found = first_difference((HEADER, RECORDS), (HEADER, with_second(outcome=EpisodeOutcome.STEPS)))
    assert found == LogDifference(episode=2, key="outcome", first=EpisodeOutcome.SUCCESS, second=EpisodeOutcome.STEPS)
    assert first_difference((HEADER, RECORDS), (HEADER, RECORDS[1:])) == LogDifference(
        episode=1, key="episode", first=1, second=2
    )


@pytest.mark.parametrize("version", ["0", "2"])
def test_both_values_of_a_header_are_shown(version: str) -> None:
    other = LogHeader(manifest=make_manifest(solver_version=version))
    assert first_difference((HEADER, []), (other, [])) == LogDifference(key="solver_version", first="1", second=version)


def test_the_last_state_is_compared() -> None:
    last = RECORDS[1].env_steps
    assert difference(with_second(state_hashes=(*RECORDS[1].state_hashes[:-1], "f" * 64))) == (2, last, "state_hash")


def test_earlier_episode_wins_over_later() -> None:
    later = [make_record(1), make_record(2, outcome=EpisodeOutcome.STEPS), make_record(3, shape="other")]
    assert difference(later) == (2, None, "outcome")
