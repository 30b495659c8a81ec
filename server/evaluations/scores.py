"""Scores as they are stored with an evaluation and as they are shown; called where evaluations end and are read."""

import hashlib
from collections.abc import Collection, Mapping
from datetime import datetime
from typing import Any

from sqlalchemy.orm import Session
from vitac.evaluator.episodes.records import EpisodeRecord, Manifest, result_hash
from vitac.evaluator.ranking import Ranking
from vitac.evaluator.scoring.score import (
    CombinedScore,
    Interval,
    Rate,
    Score,
    better_on_public_p_value,
    combine,
    interval_of_difference,
    score,
)
from vitac.evaluator.tracks import Track

from ..competitions.competition import find_stage
from ..database.models import ALL_TASKS, BoardResult, Evaluation, Submission
from ..receipts.receipt import CombinedResult
from ..tracks import known_track
from ..views.scores import PlayedScoreView, PracticeScoreView, ShapeScoreView, TaskScoreView

Records = Mapping[str, Collection[EpisodeRecord]]
"""Records of an evaluation on one list, by task."""


def store_scores(
    session: Session,
    evaluation: Evaluation,
    scores: Mapping[str, Score],
    hashes: Mapping[str, str],
    *,
    finished_at: datetime,
) -> None:
    """Write the score of each task into the row of an evaluation; one that is not only proposed enters the boards.

    The tasks that count are stored with them, so that no later track file changes the result.
    """
    evaluation.scores = [
        {"task": task, "result_hash": hashes[task], **score.model_dump(mode="json")} for task, score in scores.items()
    ]
    evaluation.counted_tasks = list(_tasks_that_count(evaluation.submission))
    if not evaluation.is_proposed:
        add_to_boards(session, evaluation, finished_at)


def store_practice_scores(
    evaluation: Evaluation, track: Track, *, sealed: Records, public: Records, manifests: Mapping[str, Manifest]
) -> None:
    """Write what an evaluation reached on the public list, and how it differs from the sealed one that ranks.

    Args:
        evaluation: of which both lists were played.
        track: which one.
        sealed: the records of each task on the sealed list.
        public: the same on the public list.
        manifests: what each task was played with there.
    """
    evaluation.practice_scores = [
        {
            "task": task,
            "result_hash": result_hash(manifests[task], records),
            "p_value": better_on_public_p_value(track.task(task).episode_list, records, sealed[task]),
            **score(records, track.task(task).definition.measures).model_dump(mode="json"),
        }
        for task, records in public.items()
    ]


def store_fresh_scores(evaluation: Evaluation, track: Track, records: Records) -> None:
    """Write what an evaluation reached on its fresh list."""
    evaluation.fresh_scores = [
        {"task": task, **score(of_task, track.task(task).definition.measures).model_dump(mode="json")}
        for task, of_task in records.items()
    ]


def read_fresh_scores(evaluation: Evaluation) -> dict[str, Score]:
    """Return the score of each task on the fresh list; empty without one."""
    return {row["task"]: Score.model_validate(_select_score(row)) for row in evaluation.fresh_scores or []}


def add_to_boards(session: Session, evaluation: Evaluation, finished_at: datetime) -> None:
    """Write what a scored evaluation is ranked by on each board, from a moment on."""
    stage = find_stage(session, evaluation.submission)
    boards: dict[str | None, Score | CombinedScore] = dict(read_scores(evaluation).items())
    combined = combined_score(evaluation)
    if combined is not None and evaluation.submission.kind.form.runs_policy:
        boards[None] = combined
    evaluation.board_results = [
        _board_result(evaluation, task, stage.find_ranking(task), score, finished_at) for task, score in boards.items()
    ]


def combine_hashes(hashes: Mapping[str, str]) -> str:
    """Return the hash of the one task; of several, SHA-256 [hex] over a line `task hash` for each, by task name."""
    if len(hashes) == 1:
        return next(iter(hashes.values()))
    lines = "".join(f"{task} {hashes[task]}\n" for task in sorted(hashes))
    return hashlib.sha256(lines.encode()).hexdigest()


def read_scores(evaluation: Evaluation) -> dict[str, Score]:
    """Return the stored score of each task; empty before the end."""
    return {row["task"]: Score.model_validate(_select_score(row)) for row in evaluation.scores or []}


def combined_score(evaluation: Evaluation) -> CombinedScore | None:
    """Return the score over all tasks that count; None without a score."""
    return combine_scores(evaluation, read_scores(evaluation))


def combined_result(evaluation: Evaluation) -> CombinedResult | None:
    """Return the score over all tasks for the receipt of an evaluation; None where there is none, as for a log."""
    combined = combined_score(evaluation) if evaluation.submission.kind.form.runs_policy else None
    return (
        CombinedResult(
            success_rate=combined.success_rate, mean_steps=combined.mean_steps, measures=dict(combined.measures)
        )
        if combined
        else None
    )


def combine_scores(evaluation: Evaluation, scores: Mapping[str, Score]) -> CombinedScore | None:
    """Return the combined score of already loaded task scores; None where none of the tasks that count was played."""
    counting = counted_tasks(evaluation)
    return combine(counting, scores) if not scores.keys().isdisjoint(counting) else None


def played_score(counting: Collection[str], scores: Mapping[str, Score]) -> PlayedScoreView | None:
    """Return the score over those tasks that were played, of the ones that count; None where none was."""
    played = {task: scores[task] for task in counting if task in scores}
    if not played:
        return None
    combined = combine(played, played)
    return PlayedScoreView(
        tasks=list(played),
        episodes=sum(score.episodes for score in played.values()),
        starts=sum(score.starts for score in played.values()),
        successes=sum(score.successes for score in played.values()),
        success_rate=combined.success_rate,
        success_rate_interval=bounds(combined.interval),
        mean_steps=combined.mean_steps,
    )


def counted_tasks(evaluation: Evaluation) -> Collection[str]:
    """Return the tasks that are combined: those that counted when it was scored, before that those of the file."""
    kept = evaluation.counted_tasks
    return kept if kept is not None else _tasks_that_count(evaluation.submission)


def score_views(evaluation: Evaluation) -> list[TaskScoreView]:
    """Return the score of each task as it is shown."""
    return task_views(evaluation, read_scores(evaluation))


def task_views(evaluation: Evaluation, scores: Mapping[str, Score]) -> list[TaskScoreView]:
    """Return already loaded task scores as they are shown."""
    hashes = {row["task"]: row["result_hash"] for row in evaluation.scores or []}
    return [_score_view(task, score, hashes[task]) for task, score in scores.items()]


def practice_score_views(evaluation: Evaluation) -> list[PracticeScoreView] | None:
    """Return what was reached on the public list beside the sealed one; None where it was not played."""
    if evaluation.practice_scores is None:
        return None
    sealed, rows = read_scores(evaluation), evaluation.practice_scores
    return [_practice_score_view(row, sealed[row["task"]]) for row in rows]


def _practice_score_view(row: Mapping[str, Any], sealed: Score) -> PracticeScoreView:
    public, p_value = Score.model_validate(_select_score(row)), float(row["p_value"])
    points = 100 * (public.success_rate - sealed.success_rate)
    low, high = interval_of_difference(public, sealed)
    sentence = (
        f"Public list: {100 * public.success_rate:.1f} % ({public.successes} of {public.episodes}), "
        f"{abs(points):.1f} points {'above' if points > 0 else 'below'} the sealed one "
        f"(95 % interval {100 * low:+.1f} to {100 * high:+.1f}). Better on the public list "
        f"than on the sealed one: p = {p_value:.2g}."
    )
    return PracticeScoreView(
        **dict(_score_view(row["task"], public, row["result_hash"])), p_value=p_value, sentence=sentence
    )


def bounds(interval: Interval) -> tuple[float, float]:
    """Return both ends of an interval, as views hold them."""
    return interval.low, interval.high


def _select_score(row: Mapping[str, Any]) -> dict[str, Any]:
    """Return what a stored row has of a score; one from before forces were recorded has none."""
    return {key: row[key] for key in Score.model_fields if key in row}


def _board_result(
    evaluation: Evaluation, task: str | None, ranking: Ranking, score: Score | CombinedScore, finished_at: datetime
) -> BoardResult:
    submission = evaluation.submission
    values = ranking.values(score, submission.submitted_at)
    return BoardResult(
        board=ALL_TASKS if task is None else task,
        competition=submission.competition,
        track=submission.track,
        stage=submission.stage,
        kind=submission.kind.board,
        team_id=submission.team_id,
        submission_id=submission.id,
        evaluator_version=evaluation.evaluator_version,
        ranked_by=values,
        sort_key=list(ranking.sort_key(values)),
        submitted_at=submission.submitted_at,
        finished_at=finished_at,
        is_off_boards=submission.is_off_boards,
    )


def _tasks_that_count(submission: Submission) -> Collection[str]:
    """Return the combined tasks of the track for a model; a log is of one task, and ranks on its board only."""
    if not submission.kind.form.runs_policy:
        return submission.tasks
    track = known_track(submission.track)
    return track.tasks_that_count if track is not None else ()


def _score_view(task: str, score: Score, result_hash: str) -> TaskScoreView:
    return TaskScoreView.from_row(
        score,
        task=task,
        success_rate_interval=bounds(score.interval),
        shapes=[_shape_view(shape, rate) for shape, rate in sorted(score.by_shape.items())],
        outcomes={outcome.value: count for outcome, count in score.outcomes.items()},
        result_hash=result_hash,
    )


def _shape_view(shape: str, rate: Rate) -> ShapeScoreView:
    return ShapeScoreView.from_row(rate, shape=shape, success_rate_interval=bounds(rate.interval))
