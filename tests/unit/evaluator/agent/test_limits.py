from dataclasses import fields
from itertools import accumulate

import pytest
from vitac.evaluator.agent.limits import Limits, LimitsInvalid, ShardTime, StartTimes, default_period_s
from vitac.evaluator.agent.verdicts import PolicyFailed, SandboxFailed, VerdictCode


@pytest.mark.parametrize("name", [field.name for field in fields(Limits)])
@pytest.mark.parametrize("value", [0, -1, float("nan")])
def test_limits_must_be_above_zero(name: str, value: float) -> None:
    with pytest.raises(LimitsInvalid, match=name):
        Limits(**{name: value})  # type: ignore[arg-type]


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


class Clock:
    """A clock that only sleeping and `work` advance."""

    def __init__(self) -> None:
        self.now_s = 100.0

    def __call__(self) -> float:
        return self.now_s

    def advance(self, seconds: float) -> None:
        self.now_s += seconds


def starts(period_s: float, durations_s: list[float]) -> list[float]:
    """Start an episode, and one after each of these durations; return when they start after the first."""
    clock = Clock()
    times = StartTimes(period_s, clock=clock, sleep=clock.advance)
    found = []
    for duration_s in [*durations_s, 0.0]:
        times.wait()
        found.append(round(clock.now_s - 100.0, 6))
        clock.advance(duration_s)
    return found


def test_without_a_period_episodes_start_one_after_the_other() -> None:
    durations = [0.3, 0.1, 0.2]
    assert starts(0.0, durations) == [0.0, *(round(end, 6) for end in accumulate(durations))]


@pytest.mark.parametrize("durations_s", [[0.3, 0.1, 0.2], [0.01, 0.49, 0.3]])
def test_how_long_episodes_take_within_the_period_does_not_show(durations_s: list[float]) -> None:
    assert starts(0.5, durations_s) == [0.0, 0.5, 1.0, 1.5]


def test_a_longer_one_doubles_the_period_for_all_that_follow() -> None:
    assert starts(0.5, [0.1, 1.7, 0.1, 0.1]) == [0.0, 0.5, 2.5, 4.5, 6.5]
    assert starts(0.5, [0.1, 1.3, 0.1, 0.1]) == [0.0, 0.5, 2.5, 4.5, 6.5], "both look alike"


def test_the_environment_names_the_period(monkeypatch: pytest.MonkeyPatch) -> None:
    assert default_period_s() == 0.0
    monkeypatch.setenv("VITAC_EPISODE_PERIOD_S", "0.25")
    assert default_period_s() == 0.25


@pytest.mark.parametrize("named", ["-1", "inf", "nan", "soon"])
def test_what_is_no_period_is_refused(named: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("VITAC_EPISODE_PERIOD_S", named)
    with pytest.raises(SandboxFailed, match="Expected VITAC_EPISODE_PERIOD_S to be a number of seconds"):
        default_period_s()
