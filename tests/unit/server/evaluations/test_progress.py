"""How far an evaluation is and when it ends, from counts; without a database."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from vitac.evaluator.tracks import load_track
from vitac.server.database.models import Evaluation, Submission
from vitac.server.evaluations.progress import make_progress_view, seconds_to_end
from vitac.server.views.evaluations import ProgressView

TRACK = load_track("track_1")
PEG, LOCK = (len(TRACK.tasks[task].episodes) for task in ("peg-insertion", "lock-opening"))


def submission(*tasks: str) -> Submission:
    return Submission(track="track_1", tasks=list(tasks))


def progress(done: int, total: int) -> ProgressView:
    return ProgressView(episodes_done=done, episodes_total=total, episodes_reused=0, successes=0, tasks=[])


def test_before_the_first_episode_everything_is_left() -> None:
    found = make_progress_view(Evaluation(episodes_reused=0), submission("peg-insertion", "lock-opening"))
    assert (found.episodes_done, found.episodes_total, found.successes) == (0, PEG + LOCK, 0)
    assert [(task.task, task.episodes_total) for task in found.tasks] == [
        ("peg-insertion", PEG),
        ("lock-opening", LOCK),
    ]


def test_counts_are_shown_by_task_and_added_up() -> None:
    counts = {"peg-insertion": (12, 5), "lock-opening": (3, 3)}
    found = make_progress_view(Evaluation(episodes_reused=4), submission("lock-opening", "peg-insertion"), counts)
    assert (found.episodes_done, found.successes, found.episodes_reused) == (15, 8, 4)
    assert [(task.task, task.episodes_done, task.successes) for task in found.tasks] == [
        ("lock-opening", 3, 3),
        ("peg-insertion", 12, 5),
    ]


def test_a_task_that_the_submission_lacks_is_not_counted() -> None:
    found = make_progress_view(Evaluation(episodes_reused=0), submission("peg-insertion"), {"lock-opening": (3, 3)})
    assert (found.episodes_done, found.episodes_total) == (0, PEG)


def test_scores_count_where_there_are_any() -> None:
    scores = [{"task": "peg-insertion", "episodes": PEG, "successes": 200}]
    evaluation = Evaluation(episodes_reused=0, scores=scores)
    found = make_progress_view(evaluation, submission("peg-insertion"), {"peg-insertion": (1, 1)})
    assert (found.episodes_done, found.successes) == (PEG, 200)
    shorter = Evaluation(episodes_reused=0, scores=[{"task": "peg-insertion", "episodes": 12, "successes": 3}])
    assert make_progress_view(shorter, submission("peg-insertion")).episodes_total == 12, "its list was another one"


@pytest.mark.parametrize(
    ("done", "ahead", "slots", "mean_s", "seconds"),
    [
        (0, 0, 1, 2.0, 20.0),
        (4, 0, 1, 2.0, 12.0),
        (4, 14, 1, 2.0, 40.0),
        (4, 14, 4, 2.0, 10.0),
        (10, 0, 3, 2.0, 0.0),
        (0, 0, 0, 2.0, None),
        (0, 0, 2, None, None),
        (0, 5, 0, None, None),
    ],
)
def test_the_end_is_where_all_before_and_our_own_are_played(
    done: int, ahead: int, slots: int, mean_s: float | None, seconds: float | None
) -> None:
    assert seconds_to_end(progress(done, 10), ahead=ahead, slots=slots, mean_s=mean_s) == seconds


@given(st.integers(0, 50), st.integers(0, 500), st.integers(1, 64), st.floats(0.01, 60.0))
def test_more_workers_end_earlier_and_more_before_us_later(done: int, ahead: int, slots: int, mean_s: float) -> None:
    def seconds(ahead: int, slots: int) -> float:
        found = seconds_to_end(progress(done, 50), ahead=ahead, slots=slots, mean_s=mean_s)
        assert found is not None
        return found

    assert seconds(ahead, slots + 1) <= seconds(ahead, slots) <= seconds(ahead + 1, slots)
    assert seconds(ahead, slots) >= 0.0
