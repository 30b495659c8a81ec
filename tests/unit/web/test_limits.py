from dataclasses import fields, replace

import pytest
from vitac.evaluator.agent.limits import Limits
from vitac.web.headers import LimitRow, limit_rows, size, time_limits

NOT_FOR_TEAMS = {"message_bytes"}  # of the channel, which only the evaluator's runtime uses


def test_shows_what_a_limit_is() -> None:
    rows = {row.title: row.value for row in limit_rows(Limits())}
    assert rows["Memory of the policy and its children"] == "3 GiB"
    assert rows["One action"] == "2 s of CPU time, 10 s of wall time"
    assert rows["All episodes of a shard, with loading"] == "300 s of CPU time, 900 s of wall time"
    assert rows["Archive, packed"] == "512 MiB"


@pytest.mark.parametrize("name", [field.name for field in fields(Limits) if field.name not in NOT_FOR_TEAMS])
def test_every_limit_is_in_the_table(name: str) -> None:
    changed = replace(
        Limits(),
        **{name: getattr(Limits(), name) / 2 if name.endswith(("_s", "ratio")) else getattr(Limits(), name) // 2},
    )
    assert limit_rows(changed) != limit_rows(Limits())


@pytest.mark.parametrize(("count", "text"), [(12, "12 bytes"), (1 << 10, "1 KiB"), (1536 << 20, "1.5 GiB")])
def test_sizes_have_a_unit(count: int, text: str) -> None:
    assert size(count) == text


@pytest.mark.parametrize(
    ("cpu_s", "wall_s", "text"),
    [
        (5.0, None, "5 s of CPU time"),
        (0.5, 2.0, "0.5 s of CPU time, 2 s of wall time"),
        (3600.0, 7200.0, "3600 s of CPU time, 7200 s of wall time"),
    ],
)
def test_times_are_named_by_what_they_count(cpu_s: float, wall_s: float | None, text: str) -> None:
    assert time_limits(cpu_s, wall_s) == text


@pytest.mark.parametrize(
    ("count", "text"),
    [(0, "0 bytes"), (1023, "1023 bytes"), (1024, "1 KiB"), ((1 << 20) - 1, "1024 KiB"), (3 << 29, "1.5 GiB")],
)
def test_a_size_is_in_the_largest_unit_that_it_reaches(count: int, text: str) -> None:
    assert size(count) == text


def test_rows_have_one_title_each_and_the_network_is_closed() -> None:
    rows = limit_rows(Limits())
    assert len({row.title for row in rows}) == len(rows)
    assert rows[-1] == LimitRow(title="Network", value="none")
