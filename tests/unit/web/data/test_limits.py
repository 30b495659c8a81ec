from dataclasses import fields, replace

import pytest
from vitac.evaluator.agent.limits import Limits
from vitac.web.data.limits import limit_rows, size

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
