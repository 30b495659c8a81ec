"""Standings of a track and of its tasks: reads completed evaluations only, ranks them by the evaluator's rule."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from uuid import UUID

from sqlalchemy import select
from sqlalchemy.orm import Session, joinedload
from vitac.evaluator.scoring.ranking import CombinedScore, Standing, rank
from vitac.evaluator.scoring.score import Score
from vitac.evaluator.tracks import load_track
from vitac.evaluator.version import evaluator_version
from vitac.server.db.models import Evaluation, Submission
from vitac.server.db.states import EvaluationState, SubmissionKind
from vitac.server.evaluations.scores import bounds, combined_score, score_views, scores_of
from vitac.server.tracks import load_known_track, require_task
from vitac.server.views.leaderboards import LeaderboardEntryView, LeaderboardView
from vitac.server.views.submissions import RankView

PlacesOfBoards = Mapping[str | None, Mapping[UUID, RankView]]
"""Places by submission on each board of a track: that of a task, or under None that of all tasks together."""


@dataclass(frozen=True, kw_only=True)
class Result:
    """A completed evaluation with what it is ranked by on a board."""

    evaluation: Evaluation
    score: Score | CombinedScore

    @property
    def team_id(self) -> UUID:
        """Whose it is."""
        return self.evaluation.submission.team_id


def leaderboard(session: Session, track_name: str, *, task: str | None = None) -> LeaderboardView:
    """Return the best entry of each team, ranked; then teams with results of another evaluator version only.

    Args:
        session: of the transaction.
        track_name: whose board.
        task: ranks the submissions that play this task by it alone; None: all tasks of the track together.

    Raises:
        ServiceError: there is no such track or task.
    """
    track = load_known_track(track_name)
    if task is not None:
        require_task(track, task)
    current = evaluator_version()
    results = results_on(_completed(session, track_name), task)
    ranked = best_of_teams(result for result in results if result.evaluation.evaluator_version == current)
    teams = {result.team_id for result in ranked}
    stale = best_of_teams(result for result in results if result.team_id not in teams)
    entries = [_entry(result, place, task) for place, result in enumerate(ranked, start=1)]
    entries += [_entry(result, None, task) for result in stale]
    return LeaderboardView(
        track=track.name,
        title=track.title,
        tasks=list(track.tasks),
        task=task,
        ranking_rule=track.ranking_rule if task or not track.combination_rule else track.combination_rule,
        evaluator_version=current,
        generated_at=datetime.now(UTC),
        teams=len(entries),
        entries=entries,
    )


def places(session: Session, track_name: str) -> PlacesOfBoards:
    """Places of the submissions that are their team's best entry on a board of the track."""
    current = evaluator_version()
    completed = [
        evaluation for evaluation in _completed(session, track_name) if evaluation.evaluator_version == current
    ]
    boards = (None, *load_track(track_name).tasks)
    return {task: _places(best_of_teams(results_on(completed, task))) for task in boards}


def results_on(evaluations: Iterable[Evaluation], task: str | None) -> list[Result]:
    """Those evaluations that have a score on the board of a task (None: of all tasks together), with it."""
    scores = (
        (evaluation, combined_score(evaluation) if task is None else scores_of(evaluation).get(task))
        for evaluation in evaluations
    )
    return [Result(evaluation=evaluation, score=score) for evaluation, score in scores if score is not None]


def best_of_teams(results: Iterable[Result]) -> list[Result]:
    """One result for each team, in the order of the ranking rule."""
    by_id = {str(result.evaluation.id): result for result in results}
    best: dict[UUID, Result] = {}
    for ranked in rank(_standing(result) for result in by_id.values()):
        result = by_id[ranked.standing.id]
        best.setdefault(result.team_id, result)
    return list(best.values())


def _completed(session: Session, track: str) -> Sequence[Evaluation]:
    return session.scalars(
        select(Evaluation)
        .join(Submission)
        .options(joinedload(Evaluation.submission).joinedload(Submission.team))
        .where(
            Evaluation.state == EvaluationState.COMPLETED,
            Submission.track == track,
            Submission.kind == SubmissionKind.MODEL,
        )
    ).all()


def _standing(result: Result) -> Standing:
    return Standing(
        id=str(result.evaluation.id),
        success_rate=result.score.success_rate,
        mean_steps=result.score.mean_steps,
        submitted_at=result.evaluation.created_at,
    )


def _places(ranked: Sequence[Result]) -> dict[UUID, RankView]:
    return {
        result.evaluation.submission_id: RankView(rank=place, of=len(ranked))
        for place, result in enumerate(ranked, start=1)
    }


def _entry(result: Result, place: int | None, task: str | None) -> LeaderboardEntryView:
    evaluation, submission = result.evaluation, result.evaluation.submission
    scores = [score for score in score_views(evaluation) if task in {None, score.task}]
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
        success_rate=result.score.success_rate,
        success_rate_interval=bounds(result.score.interval),
        mean_steps=result.score.mean_steps,
        scores=scores,
        result_hash=evaluation.result_hash or "",
        evaluator_version=evaluation.evaluator_version,
    )
