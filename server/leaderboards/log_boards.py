"""Logs of a track, apart from its evaluated models: verified ones ranked by task, 2025 text logs beside their claims.

A log proves its actions, not that a policy chose them, so it never ranks together with models.
"""

from collections.abc import Sequence
from datetime import UTC, datetime

from sqlalchemy import Select, select
from sqlalchemy.dialects.postgresql import distinct_on
from sqlalchemy.orm import Session, joinedload
from vitac.evaluator.version import evaluator_version
from vitac.server.db.models import Evaluation, Submission
from vitac.server.db.states import EvaluationState, SubmissionKind
from vitac.server.evaluations.scores import score_views
from vitac.server.leaderboards.standings import Result, best_of_teams, results_on
from vitac.server.logs.claims import LogClaim
from vitac.server.logs.view import LABELS, verdict_of
from vitac.server.tracks import load_known_track
from vitac.server.views.leaderboards import LogBoardsView, LogBoardView, LogEntryView, TextLogEntryView

RANKING_RULE = (
    "Higher success rate first; then fewer mean env steps of the successful episodes; then the earlier submission. "
    "Only verified logs are ranked, the best of each team, task by task, and never together with models."
)
MOST_TEXT_LOGS = 200


def log_boards(session: Session, track_name: str) -> LogBoardsView:
    """Return the logs of a track.

    Raises:
        ServiceError: there is no such track.
    """
    track = load_known_track(track_name)
    verified = session.scalars(_with_teams(_completed(track_name, SubmissionKind.LOG))).all()
    return LogBoardsView(
        track=track.name,
        title=track.title,
        label=LABELS[SubmissionKind.LOG],
        ranking_rule=RANKING_RULE,
        evaluator_version=evaluator_version(),
        generated_at=datetime.now(UTC),
        boards=[
            LogBoardView(task=name, title=task.title, entries=_entries(verified, name))
            for name, task in track.tasks.items()
        ],
        text_logs=[_text_log(e) for e in _newest_text_logs(session, track_name)],
    )


def _completed(track: str, kind: SubmissionKind) -> Select[Evaluation]:
    return (
        select(Evaluation)
        .join(Submission)
        .where(Evaluation.state == EvaluationState.COMPLETED, Submission.track == track, Submission.kind == kind)
    )


def _with_teams(evaluations: Select[Evaluation]) -> Select[Evaluation]:
    """With their submissions and teams, newest first."""
    return evaluations.options(joinedload(Evaluation.submission).joinedload(Submission.team)).order_by(
        Evaluation.created_at.desc(), Evaluation.id
    )


def _newest_text_logs(session: Session, track: str) -> Sequence[Evaluation]:
    """Return the newest completed evaluation of each text log, cut before anything is loaded."""
    newest_of_each = (
        _completed(track, SubmissionKind.TEXT_LOG)
        .with_only_columns(Evaluation.id)
        .ext(distinct_on(Evaluation.submission_id))
        .order_by(Evaluation.submission_id, Evaluation.created_at.desc(), Evaluation.id)
    )
    chosen = select(Evaluation).where(Evaluation.id.in_(newest_of_each))
    return session.scalars(_with_teams(chosen).limit(MOST_TEXT_LOGS)).all()


def _entries(evaluations: Sequence[Evaluation], task: str) -> list[LogEntryView]:
    """Return the best log of each team that this evaluator verified; then those of teams that only have older ones."""
    results, current = results_on(evaluations, task), evaluator_version()
    ranked = best_of_teams(result for result in results if result.evaluation.evaluator_version == current)
    teams = {result.team_id for result in ranked}
    stale = best_of_teams(result for result in results if result.team_id not in teams)
    entries = [_entry(result, place) for place, result in enumerate(ranked, start=1)]
    return entries + [_entry(result, None) for result in stale]


def _entry(result: Result, place: int | None) -> LogEntryView:
    evaluation, submission = result.evaluation, result.evaluation.submission
    score = score_views(evaluation)[0]
    claim = LogClaim.model_validate(submission.manifest)
    return LogEntryView(
        rank=place,
        stale=place is None,
        team=submission.team.name,
        submission_id=submission.id,
        submission_name=submission.name,
        verdict=verdict_of(claim, evaluation),
        submitted_at=evaluation.created_at,
        episodes=score.episodes,
        successes=score.successes,
        success_rate=score.success_rate,
        success_rate_interval=score.success_rate_interval,
        mean_steps=score.mean_steps,
        result_hash=score.result_hash,
        evaluator_version=evaluation.evaluator_version,
    )


def _text_log(evaluation: Evaluation) -> TextLogEntryView:
    submission = evaluation.submission
    claim, score = LogClaim.model_validate(submission.manifest), score_views(evaluation)[0]
    return TextLogEntryView(
        team=submission.team.name,
        task=score.task,
        submission_id=submission.id,
        submission_name=submission.name,
        submitted_at=submission.submitted_at,
        claimed_success_rate=claim.success_rate,
        claimed_mean_steps=claim.mean_steps,
        success_rate=score.success_rate,
        mean_steps=score.mean_steps,
        problems=len(claim.problems),
        evaluator_version=evaluation.evaluator_version,
    )
