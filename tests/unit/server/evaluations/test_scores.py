"""Scores in the row of an evaluation: stored, read back, combined and shown; without a database."""

import hashlib
from datetime import UTC, datetime
from uuid import UUID

import pytest
from evaluation_records import make_record
from hypothesis import given
from hypothesis import strategies as st
from sqlalchemy.orm import Session
from vitac.evaluator.episodes.records import EpisodeOutcome
from vitac.evaluator.scoring.score import Score, combine, score
from vitac.evaluator.submission_kinds import SubmissionKind
from vitac.evaluator.tracks import load_track
from vitac.server.database.models import ALL_TASKS, Evaluation, Submission
from vitac.server.evaluations.scores import (
    combine_hashes,
    combine_scores,
    combined_result,
    combined_score,
    counted_tasks,
    played_score,
    read_scores,
    score_views,
    store_scores,
)

PEG, LOCK = "peg-insertion", "lock-opening"
WHEN = datetime(2025, 3, 1, tzinfo=UTC)
ENDED = datetime(2025, 3, 2, tzinfo=UTC)


def score_of(*outcomes: EpisodeOutcome, env_steps: int = 3) -> Score:
    return score([make_record(number, outcome, env_steps) for number, outcome in enumerate(outcomes, start=1)])


SOLVED, LOST = EpisodeOutcome.SUCCESS, EpisodeOutcome.TACTILE
HALF = score_of(SOLVED, LOST, SOLVED, LOST)
NONE = score_of(LOST, EpisodeOutcome.ERROR)


def evaluation(*tasks: str, kind: SubmissionKind = SubmissionKind.MODEL) -> Evaluation:
    """An evaluation that has not been scored yet."""
    submission = Submission(
        id=UUID(int=1),
        team_id=UUID(int=2),
        track="track_1",
        tasks=list(tasks),
        kind=kind,
        submitted_at=WHEN,
        competition="",
        stage="",
    )
    return Evaluation(submission=submission, evaluator_version="7+abc")


def scored(scores: dict[str, Score], kind: SubmissionKind = SubmissionKind.MODEL) -> Evaluation:
    found = evaluation(*scores, kind=kind)
    store_scores(Session(), found, scores, {task: f"hash of {task}" for task in scores}, finished_at=ENDED)
    return found


def test_before_the_end_there_is_no_score() -> None:
    running = evaluation(PEG)
    assert read_scores(running) == {}
    assert score_views(running) == []
    assert combined_score(running) is None
    assert combine_scores(running, {}) is None


def test_scores_are_read_back_as_they_were_stored() -> None:
    scores = {PEG: HALF, LOCK: NONE}
    assert read_scores(scored(scores)) == scores


def test_the_row_holds_each_tasks_hash_beside_its_score() -> None:
    rows = scored({PEG: HALF, LOCK: NONE}).scores or []
    assert [(row["task"], row["result_hash"]) for row in rows] == [(PEG, f"hash of {PEG}"), (LOCK, f"hash of {LOCK}")]
    assert rows[0].keys() == {"task", "result_hash", *Score.model_fields}
    assert rows[0]["outcomes"] == {"success": 2, "tactile": 2}


def test_a_model_is_ranked_on_the_board_of_each_task_and_of_all_together() -> None:
    results = scored({PEG: HALF, LOCK: NONE}).board_results
    assert [(result.board, result.ranked_by["success_rate"], result.ranked_by["mean_steps"]) for result in results] == [
        (PEG, 0.5, 3.0),
        (LOCK, 0.0, None),
        (ALL_TASKS, 0.25, None),
    ]
    for result in results:
        assert (result.track, result.kind, result.evaluator_version) == ("track_1", SubmissionKind.MODEL, "7+abc")
        assert (result.team_id, result.submission_id) == (UUID(int=2), UUID(int=1))
        assert (result.submitted_at, result.finished_at, result.stage) == (WHEN, ENDED, "")


def test_a_task_that_a_model_does_not_play_counts_as_nothing() -> None:
    *_, together = scored({PEG: HALF}).board_results
    assert (together.board, together.ranked_by["success_rate"]) == (ALL_TASKS, 0.25)
    assert together.ranked_by["mean_steps"] is None


def test_what_was_played_is_scored_over_these_tasks_alone() -> None:
    played = played_score([PEG, LOCK], {LOCK: HALF})
    assert played is not None
    assert (played.tasks, played.successes, played.episodes, played.success_rate) == ([LOCK], 2, 4, 0.5)
    assert played.success_rate_interval == pytest.approx((HALF.interval.low, HALF.interval.high))
    assert played.mean_steps == HALF.mean_steps
    assert played_score([PEG], {LOCK: HALF}) is None


@pytest.mark.parametrize("kind", [SubmissionKind.LOG, SubmissionKind.TEXT_LOG])
def test_a_log_is_on_the_board_of_its_task_only(kind: SubmissionKind) -> None:
    found = scored({PEG: HALF}, kind)
    assert [result.board for result in found.board_results] == [PEG]
    combined = combined_score(found)
    assert combined is not None
    assert (combined.success_rate, combined.mean_steps) == (HALF.success_rate, HALF.mean_steps)


def test_the_combination_is_that_of_all_tasks_of_the_track() -> None:
    scores = {PEG: HALF, LOCK: score_of(SOLVED, env_steps=7)}
    combined = combined_score(scored(scores))
    assert combined == combine(load_track("track_1").tasks, scores)
    assert combined is not None
    assert (combined.success_rate, combined.mean_steps) == (0.75, 5.0)


def test_a_combination_stays_what_it_was_when_tasks_are_added_or_removed(monkeypatch: pytest.MonkeyPatch) -> None:
    both = {PEG: HALF, LOCK: score_of(SOLVED, env_steps=7)}
    found = {"one task": scored({PEG: HALF}), "both": scored(both), "log": scored({PEG: HALF}, SubmissionKind.LOG)}
    before = {name: (combined_score(each), combined_result(each)) for name, each in found.items()}
    assert [each.counted_tasks for each in found.values()] == [[PEG, LOCK], [PEG, LOCK], [PEG]]
    track = load_track("track_1")
    third = track.tasks[PEG].model_copy(update={"name": "third"})
    for tasks in ({PEG: track.tasks[PEG]}, {"third": third}, {**track.tasks, "third": third}):
        changed = track.model_copy(update={"tasks": tasks})
        monkeypatch.setattr("vitac.server.tracks.load_track", lambda _, changed=changed: changed)
        assert {name: (combined_score(each), combined_result(each)) for name, each in found.items()} == before
        assert counted_tasks(evaluation(PEG)) == changed.tasks_that_count, "it is not scored yet"
    for each in found.values():
        each.submission.track = "gone"
    assert {name: (combined_score(each), combined_result(each)) for name, each in found.items()} == before


def test_a_model_scored_before_tasks_were_kept_has_no_combination_without_its_track() -> None:
    of_track, of_task = scored({PEG: HALF}), scored({PEG: HALF})
    of_track.submission.track = "gone"
    of_task.scores = [{**(of_task.scores or [])[0], "task": "gone"}]
    log = scored({PEG: HALF}, SubmissionKind.LOG)
    log.submission.track = "gone"
    of_track.counted_tasks = of_task.counted_tasks = log.counted_tasks = None
    assert [combined_score(found) for found in (of_track, of_task)] == [None, None]
    assert [combined_result(found) for found in (of_track, of_task)] == [None, None]
    assert read_scores(of_track) == {PEG: HALF}
    combined = combined_score(log)
    assert combined is not None
    assert combined.success_rate == HALF.success_rate, "it is of one task, whatever the track combines"


def test_a_score_is_shown_with_its_interval_shapes_and_outcomes() -> None:
    (view,) = score_views(scored({PEG: HALF}))
    assert (view.task, view.episodes, view.successes, view.success_rate) == (PEG, 4, 2, 0.5)
    assert view.success_rate_interval == (HALF.interval.low, HALF.interval.high)
    assert (view.mean_steps, view.result_hash) == (3.0, f"hash of {PEG}")
    assert view.outcomes == {"success": 2, "tactile": 2}
    assert [(shape.shape, shape.episodes, shape.successes) for shape in view.shapes] == [
        ("concave1", 1, 1),
        ("cuboid", 2, 1),
        ("trapezoid", 1, 0),
    ]
    for shape in view.shapes:
        low, high = shape.success_rate_interval
        assert low <= shape.success_rate <= high


def test_the_hash_of_one_task_is_its_own() -> None:
    assert combine_hashes({PEG: "a" * 64}) == "a" * 64


def test_the_hash_of_several_tasks_follows_the_documented_recipe() -> None:
    text = f"{LOCK} {'b' * 64}\n{PEG} {'a' * 64}\n"
    assert combine_hashes({PEG: "a" * 64, LOCK: "b" * 64}) == hashlib.sha256(text.encode()).hexdigest()


@given(st.dictionaries(st.text("abc-", min_size=1, max_size=4), st.text("0123456789abcdef", min_size=4), min_size=2))
def test_the_hash_of_several_tasks_does_not_depend_on_their_order_but_on_each(hashes: dict[str, str]) -> None:
    combined = combine_hashes(hashes)
    assert combine_hashes(dict(reversed(list(hashes.items())))) == combined
    changed = dict(hashes)
    changed[next(iter(hashes))] += "0"
    assert combine_hashes(changed) != combined
