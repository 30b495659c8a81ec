"""Logs of a track, apart from its evaluated models: verified ones ranked by task, 2025 text logs beside their claims.

A log proves its actions, not that a policy chose them, so it never ranks together with models.
"""

from collections.abc import Sequence
from datetime import UTC, datetime

from sqlalchemy import select
from sqlalchemy.dialects.postgresql import distinct_on
from sqlalchemy.orm import Session, defer, joinedload
from vitac.evaluator.submission_kinds import SubmissionKind
from vitac.evaluator.version import evaluator_version
from vitac.server.db.models import BoardResult, Evaluation, Submission
from vitac.server.evaluations.scores import score_views
from vitac.server.leaderboards.best_entries import BestEntry, Board, best_entries
from vitac.server.leaderboards.standings import completed_evaluations
from vitac.server.logs.claims import LogClaim
from vitac.server.logs.view import verification_of
from vitac.server.tracks import load_known_track
from vitac.server.views.leaderboards import LogBoardsView, LogBoardView, LogEntryView, TextLogEntryView

RANKING_RULE = (
    "Higher success rate first; then fewer mean env steps of the successful episodes; then the earlier submission. "
    "Only verified logs are ranked, the best of each team, task by task, and never together with models."
)
MAX_TEXT_LOGS = 200


def log_boards(session: Session, track_name: str) -> LogBoardsView:
    """Return the logs of a track.

    Raises:
        ServiceError: there is no such track.
    """
    track = load_known_track(track_name)
    return LogBoardsView(
        track=track.name,
        title=track.title,
        label=SubmissionKind.LOG.form.worth,
        ranking_rule=RANKING_RULE,
        evaluator_version=evaluator_version(),
        generated_at=datetime.now(UTC),
        boards=[
            LogBoardView(task=name, title=task.title, entries=_entries(session, track_name, name))
            for name, task in track.tasks.items()
        ],
        text_logs=[_text_log(e) for e in _newest_text_logs(session, track_name)],
    )


def _newest_text_logs(session: Session, track: str) -> Sequence[Evaluation]:
    """Return the newest completed evaluation of each text log, cut before anything is loaded."""
    newest_of_each = (
        select(BoardResult.evaluation_id)
        .where(BoardResult.track == track, BoardResult.kind == SubmissionKind.TEXT_LOG)
        .ext(distinct_on(BoardResult.submission_id))
        .order_by(BoardResult.submission_id, BoardResult.submitted_at.desc(), BoardResult.evaluation_id)
    )
    return session.scalars(
        select(Evaluation)
        .where(Evaluation.id.in_(newest_of_each))
        .options(defer(Evaluation.log_tail), joinedload(Evaluation.submission).joinedload(Submission.team))
        .order_by(Evaluation.created_at.desc(), Evaluation.id)
        .limit(MAX_TEXT_LOGS)
    ).all()


def _entries(session: Session, track: str, task: str) -> list[LogEntryView]:
    """Return the best log of each team that this evaluator verified; then those of teams that only have older ones."""
    best = best_entries(session, Board(track=track, kind=SubmissionKind.LOG, task=task))
    evaluations = completed_evaluations(session, best)
    return [_entry(entry, evaluations[entry.evaluation_id]) for entry in best]


def _entry(entry: BestEntry, evaluation: Evaluation) -> LogEntryView:
    submission = evaluation.submission
    score = score_views(evaluation)[0]
    claim = LogClaim.model_validate(submission.manifest)
    return LogEntryView(
        rank=entry.rank,
        stale=entry.rank is None,
        team=submission.team.name,
        submission_id=submission.id,
        submission_name=submission.name,
        verdict=verification_of(claim, evaluation),
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
