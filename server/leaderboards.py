"""Standings of a track: reads completed evaluations only, ranks them by the evaluator's rule."""

from collections.abc import Iterable
from datetime import UTC, datetime
from typing import Any
from uuid import UUID

from sqlalchemy import select
from sqlalchemy.orm import Session, joinedload
from vitac.evaluator.ranking import Standing, rank
from vitac.evaluator.tracks import Track, UnknownTrack, list_tracks, load_track
from vitac.evaluator.version import evaluator_version
from vitac.server.db.models import Evaluation, Submission
from vitac.server.db.states import EvaluationState, SubmissionKind
from vitac.server.errors import ProblemCode, ServiceError
from vitac.server.views import LeaderboardEntryView, LeaderboardView, RankView, ShapeScoreView, TaskScoreView


def leaderboard(session: Session, track_name: str) -> LeaderboardView:
    """The best entry of each team, ranked; then entries of teams that only have results of another evaluator version.

    Raises:
        ServiceError: there is no such track.
    """
    track = load_known_track(track_name)
    current = evaluator_version()
    completed = _completed(session, track_name)
    ranked = _best_of_teams(evaluation for evaluation in completed if evaluation.evaluator_version == current)
    teams = {evaluation.submission.team_id for evaluation in ranked}
    stale = _best_of_teams(evaluation for evaluation in completed if evaluation.submission.team_id not in teams)
    entries = [_entry(evaluation, place) for place, evaluation in enumerate(ranked, start=1)]
    entries += [_entry(evaluation, None) for evaluation in stale]
    return LeaderboardView(
        track=track.name,
        title=track.title,
        tasks=list(track.tasks),
        ranking_rule=track.ranking_rule,
        evaluator_version=current,
        generated_at=datetime.now(UTC),
        teams=len(entries),
        entries=entries,
    )


def places(session: Session, track_name: str) -> dict[UUID, RankView]:
    """Places of the submissions that are their team's best entry in a track."""
    current = evaluator_version()
    completed = _completed(session, track_name)
    ranked = _best_of_teams(evaluation for evaluation in completed if evaluation.evaluator_version == current)
    return {
        evaluation.submission_id: RankView(rank=place, of=len(ranked))
        for place, evaluation in enumerate(ranked, start=1)
    }


def load_known_track(name: str) -> Track:
    """The track of that name.

    Raises:
        ServiceError: there is none; the message lists those that exist.
    """
    try:
        return load_track(name)
    except UnknownTrack as error:
        raise ServiceError(ProblemCode.UNKNOWN_TRACK, str(error), tracks=list(list_tracks())) from error


def score_views(scores: Iterable[dict[str, Any]]) -> list[TaskScoreView]:
    """Stored scores as they are shown."""
    return [_score_view(row) for row in scores]


def _completed(session: Session, track: str) -> list[Evaluation]:
    return list(
        session.scalars(
            select(Evaluation)
            .join(Submission)
            .options(joinedload(Evaluation.submission).joinedload(Submission.team))
            .where(
                Evaluation.state == EvaluationState.COMPLETED,
                Submission.track == track,
                Submission.kind == SubmissionKind.MODEL,
            )
        )
    )


def _best_of_teams(evaluations: Iterable[Evaluation]) -> list[Evaluation]:
    """One evaluation for each team, in the order of the ranking rule."""
    by_id = {str(evaluation.id): evaluation for evaluation in evaluations}
    best: dict[UUID, Evaluation] = {}
    for ranked in rank(_standing(evaluation) for evaluation in by_id.values()):
        evaluation = by_id[ranked.standing.id]
        best.setdefault(evaluation.submission.team_id, evaluation)
    return list(best.values())


def _standing(evaluation: Evaluation) -> Standing:
    return Standing(
        id=str(evaluation.id),
        success_rate=evaluation.success_rate,
        mean_steps=evaluation.mean_steps,
        submitted_at=evaluation.created_at,
    )


def _entry(evaluation: Evaluation, place: int | None) -> LeaderboardEntryView:
    submission = evaluation.submission
    scores = score_views(evaluation.scores or [])
    return LeaderboardEntryView(
        rank=place,
        stale=place is None,
        team=submission.team.name,
        submission_id=submission.id,
        submission_name=submission.name,
        kind=submission.kind,
        submitted_at=evaluation.created_at,
        evaluated_at=evaluation.finished_at or evaluation.created_at,
        episodes=sum(score.episodes for score in scores),
        successes=sum(score.successes for score in scores),
        success_rate=evaluation.success_rate or 0.0,
        success_rate_interval=scores[0].success_rate_interval if len(scores) == 1 else None,
        mean_steps=evaluation.mean_steps,
        scores=scores,
        result_hash=evaluation.result_hash or "",
        evaluator_version=evaluation.evaluator_version,
    )


def _score_view(row: dict[str, Any]) -> TaskScoreView:
    return TaskScoreView(
        task=row["task"],
        episodes=row["episodes"],
        successes=row["successes"],
        success_rate=row["success_rate"],
        success_rate_interval=_interval(row),
        mean_steps=row["mean_steps"],
        shapes=[_shape_view(shape, rate) for shape, rate in sorted(row["by_shape"].items())],
        outcomes=row["outcomes"],
        result_hash=row["result_hash"],
    )


def _shape_view(shape: str, rate: dict[str, Any]) -> ShapeScoreView:
    return ShapeScoreView(
        shape=shape,
        episodes=rate["episodes"],
        successes=rate["successes"],
        success_rate=rate["success_rate"],
        success_rate_interval=_interval(rate),
    )


def _interval(rate: dict[str, Any]) -> tuple[float, float]:
    return rate["interval"]["low"], rate["interval"]["high"]
