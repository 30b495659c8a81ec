import pytest
from vitac.evaluator.agent.limits import Limits, ShardTime
from vitac.evaluator.agent.verdicts import PolicyFailed, VerdictCode


@pytest.mark.parametrize(
    ("used", "limit", "said"),
    [("cpu_s", "shard_cpu_s", "3 s of CPU time"), ("wall_s", "shard_wall_s", "longer than 3 s")],
)
def test_time_that_is_used_up_is_named(used: str, limit: str, said: str) -> None:
    shard_time = ShardTime(Limits(**{limit: 3.0}))  # type: ignore[arg-type]
    setattr(shard_time, used, 3.0)
    shard_time.check()
    setattr(shard_time, used, 3.01)
    with pytest.raises(PolicyFailed, match=said) as caught:
        shard_time.check()
    assert caught.value.verdict is VerdictCode.SHARD_TIME
