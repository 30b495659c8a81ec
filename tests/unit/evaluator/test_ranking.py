import random
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from itertools import pairwise
from math import inf, isfinite, nan

import pytest
from hypothesis import given
from hypothesis import strategies as st
from vitac.envs.tasks.definition import Better, Measure
from vitac.evaluator.ranking import DEFAULT_RANKING, Ranking, make_ranking

NOON = datetime(2025, 1, 31, 12, tzinfo=UTC)
ERROR = Measure(
    name="error_mm",
    label="error",
    meaning="final error",
    unit="mm",
    needs=("error_mm",),
    read=lambda info: (info["error_mm"],),
    better=Better.LOW,
)
GRIP = Measure(
    name="grip_n", label="grip", meaning="grip", unit="N", needs=(), read=lambda _: (1.0,), better=Better.HIGH
)
SHOWN_ONLY = Measure(name="height_mm", label="peg", meaning="height", unit="mm", needs=(), read=lambda _: (1.0,))


@dataclass(frozen=True, kw_only=True)
class Entry:
    """A score and when it was submitted."""

    name: str = "a"
    success_rate: float = 0.5
    mean_steps: float | None = 4.0
    measures: dict[str, float] = field(default_factory=dict)
    hours: int = 0

    def values(self, ranking: Ranking) -> dict[str, float | None]:
        return ranking.values(self, NOON + timedelta(hours=self.hours))

    def key(self, ranking: Ranking) -> tuple[float, ...]:
        return ranking.sort_key(self.values(ranking))


entries = st.lists(
    st.builds(
        Entry,
        name=st.uuids().map(str),
        success_rate=st.floats(0, 1) | st.sampled_from([0.0, 0.5, 1.0]),
        mean_steps=st.none() | st.sampled_from([nan, inf, -inf, 3.0, 4.5]) | st.floats(1, 9),
        measures=st.dictionaries(st.sampled_from(["error_mm", "grip_n"]), st.floats(0, 9)),
        hours=st.integers(0, 3),
    )
)
rankings = st.permutations(["success_rate", "mean_steps", "error_mm", "grip_n"]).flatmap(
    lambda names: st.integers(0, 4).map(lambda count: make_ranking([*names[:count], "submitted_at"], [ERROR, GRIP]))
)


def order(*unordered: Entry, ranking: Ranking | None = None) -> list[str]:
    chosen = ranking or Ranking()
    return [entry.name for entry in sorted(unordered, key=lambda entry: entry.key(chosen))]


def test_success_then_steps_then_time_decide() -> None:
    assert order(Entry(name="fast", mean_steps=3.0), Entry(name="slow", success_rate=0.6, mean_steps=8.0, hours=9)) == [
        "slow",
        "fast",
    ]
    assert order(Entry(name="early", mean_steps=3.1), Entry(name="late", mean_steps=3.0, hours=9)) == ["late", "early"]
    assert order(Entry(name="copy", hours=1), Entry(name="original")) == ["original", "copy"]


def test_no_success_comes_after_any_steps() -> None:
    none, some = Entry(name="none", success_rate=0.0, mean_steps=None), Entry(name="some", success_rate=0.0, hours=1)
    assert order(none, some) == ["some", "none"]


def test_a_task_is_ranked_by_what_it_measures_without_a_change_of_the_product() -> None:
    ranking = make_ranking(["error_mm", "submitted_at"], [ERROR])
    near, far = (
        Entry(name="near", success_rate=0.1, measures={"error_mm": 0.2}),
        Entry(name="far", success_rate=0.9, measures={"error_mm": 3.0}),
    )
    assert order(Entry(name="unmeasured", success_rate=1.0), far, near, ranking=ranking) == [
        "near",
        "far",
        "unmeasured",
    ]
    assert ranking.sentence == "First comes lower final error; then the earlier submission."
    assert [key.title for key in ranking.measures] == ["Error [mm]"]


@given(entries, rankings, st.randoms())
def test_the_order_is_that_of_the_keys_one_after_the_other(
    unordered: list[Entry], ranking: Ranking, shuffler: random.Random
) -> None:
    keys = sorted(entry.key(ranking) for entry in unordered)
    shuffled = list(unordered)
    shuffler.shuffle(shuffled)
    assert sorted(entry.key(ranking) for entry in shuffled) == keys
    assert not any(value != value for key in keys for value in key), "NaN sorts nowhere"
    for better, worse in pairwise(sorted(unordered, key=lambda entry: entry.key(ranking))):
        for key in ranking.keys:
            first, second = (
                ranking.values(entry, NOON + timedelta(hours=entry.hours)).get(key.name) for entry in (better, worse)
            )
            first_there, second_there = (value is not None and isfinite(value) for value in (first, second))
            assert first_there or not second_there, "what is missing comes last"
            if not (first_there and second_there) or first == second:
                if first_there != second_there:
                    break
                continue
            assert first is not None
            assert second is not None
            assert (first > second) == (key.better is Better.HIGH)
            break


@pytest.mark.parametrize(
    ("names", "sentence"),
    [
        (["sucess_rate", "submitted_at"], "did you mean success_rate"),
        (["height_mm", "submitted_at"], "ranking has 'height_mm', expected some of success_rate, mean_steps"),
        (["error_mm", "error_mm", "submitted_at"], "ranking names error_mm twice"),
        (["success_rate"], "ranking must end with submitted_at"),
        ([], "ranking must end with submitted_at"),
    ],
)
def test_keys_that_cannot_rank_are_refused(names: list[str], sentence: str) -> None:
    with pytest.raises(ValueError, match=sentence):
        make_ranking(names, [ERROR, SHOWN_ONLY])


def test_the_usual_ranking_is_the_default() -> None:
    assert make_ranking(DEFAULT_RANKING) == Ranking()


@pytest.mark.parametrize(
    ("names", "said"),
    [
        (DEFAULT_RANKING, "success rate: 50.0 %"),
        (("error_mm", "success_rate", "submitted_at"), "error [mm]: 0.123"),
        (("mean_steps", "submitted_at"), "mean env steps: 4"),
        (("grip_n", "submitted_at"), "grip [N]: none"),
        (("submitted_at",), "success rate: 50.0 %"),
    ],
)
def test_what_is_compared_first_is_said_with_its_value(names: tuple[str, ...], said: str) -> None:
    ranking = make_ranking(names, (ERROR, GRIP))
    assert ranking.describe_first(Entry(measures={"error_mm": 0.12345}).values(ranking)) == said
