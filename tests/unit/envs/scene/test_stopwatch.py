import pytest
from vitac.envs.scene.stopwatch import Stopwatch


def test_sums_the_time_within_its_block(monkeypatch: pytest.MonkeyPatch) -> None:
    ticks = iter([1.0, 1.5, 10.0, 12.0])
    monkeypatch.setattr("vitac.envs.scene.stopwatch.thread_time", lambda: next(ticks))
    watch = Stopwatch()
    with watch:
        pass
    with watch:
        pass
    assert watch.elapsed_s == 2.5


def test_counts_a_block_that_raises(monkeypatch: pytest.MonkeyPatch) -> None:
    ticks = iter([0.0, 3.0])
    monkeypatch.setattr("vitac.envs.scene.stopwatch.thread_time", lambda: next(ticks))
    watch = Stopwatch()
    with pytest.raises(ZeroDivisionError), watch:
        raise ZeroDivisionError
    assert watch.elapsed_s == 3.0
