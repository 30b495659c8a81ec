"""How long is left, as people are told."""

import pytest
from vitac.training.progress import TrainingProgress


class Clock:
    """Gives the time that it is set to."""

    def __init__(self) -> None:
        self.now_s = 1000.0

    def __call__(self) -> float:
        return self.now_s


@pytest.fixture
def clock() -> Clock:
    return Clock()


def left_after(clock: Clock, seconds: float, done: int, total: int, before: int = 0) -> str:
    progress = TrainingProgress(clock)
    assert progress.left(before, total) == ""
    clock.now_s += seconds
    return progress.left(done, total)


@pytest.mark.parametrize(
    ("seconds", "done", "told"),
    [
        (30.0, 5, ", less than 1 min left"),
        (60.0, 5, ", about 1 min left"),
        (100.0, 1, ", about 15 min left"),
        (7000.0, 5, ", about 117 min left"),
        (7200.0, 2, ", about 8.0 h left"),
        (0.0, 5, ", less than 1 min left"),
    ],
)
def test_time_left_is_that_of_the_parts_so_far(clock: Clock, seconds: float, done: int, told: str) -> None:
    assert left_after(clock, seconds, done, 10) == told


def test_parts_that_were_done_before_took_no_time(clock: Clock) -> None:
    assert left_after(clock, 120.0, 8, 10, before=6) == ", about 2 min left"


def test_parts_that_are_found_done_on_the_way_do_not_count(clock: Clock) -> None:
    progress = TrainingProgress(clock)
    progress.begin(0)
    clock.now_s += 1.0
    progress.begin(2)
    clock.now_s += 300.0
    assert progress.left(3, 12) == ", about 45 min left"


@pytest.mark.parametrize("done", [10, 11])
def test_nothing_is_said_once_all_is_done(clock: Clock, done: int) -> None:
    assert left_after(clock, 50.0, done, 10) == ""


def test_nothing_is_said_while_no_part_is_done(clock: Clock) -> None:
    assert left_after(clock, 50.0, 3, 10, before=3) == ""
    assert left_after(clock, 50.0, 2, 10, before=3) == ""


def test_estimate_follows_the_mean_of_all_parts(clock: Clock) -> None:
    progress = TrainingProgress(clock)
    progress.left(0, 4)
    told = []
    for done, seconds in ((1, 60.0), (2, 180.0), (3, 60.0)):
        clock.now_s += seconds
        told.append(progress.left(done, 4))
    assert told == [", about 3 min left", ", about 4 min left", ", about 2 min left"]
