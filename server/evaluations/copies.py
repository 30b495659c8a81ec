"""Finds logs whose states another team reached before; called when an evaluation is complete.

Re-simulation proves the actions of a log, not whose they are: whoever has a log can upload it under another header, and
changes of the actions that move nothing (-0.0 for 0.0) change its digest. Equal states tell it all the same.
"""

from collections.abc import Collection
from dataclasses import dataclass
from datetime import datetime
from uuid import UUID

from sqlalchemy import ScalarSelect, distinct, func, select, update
from sqlalchemy.dialects.postgresql import insert
from sqlalchemy.orm import Session, aliased
from vitac.evaluator.submission_kinds import SubmissionKind

from ..db.among import among
from ..db.models import BoardResult, EpisodeResult, Evaluation, LogCopy, Submission, Team
from ..db.states import EvaluationState
from ..views.logs import LogCopyView
from .episode_store import EpisodeKey


@dataclass(frozen=True, kw_only=True)
class _Twin:
    """A submission of another team with the same states in some episodes."""

    submission_id: UUID
    kind: SubmissionKind
    submitted_at: datetime
    episodes: int


def flag_copies(session: Session, evaluation: Evaluation) -> None:
    """Compare a completed evaluation with the episodes of all other teams; of a log and its twin the later is flagged.

    Either may be evaluated first. With half of its episodes or more a log is a copy, and not ranked.
    """
    submission = evaluation.submission
    twins = _twins(session, evaluation)
    moment = (submission.submitted_at, submission.id)
    earlier = [twin for twin in twins if (twin.submitted_at, twin.submission_id) < moment]
    if earlier and submission.kind is SubmissionKind.LOG:
        closest = max(earlier, key=lambda twin: twin.episodes)
        _flag(session, [evaluation], closest.submission_id, closest.episodes)
    for twin in twins:
        if twin.kind is SubmissionKind.LOG and (twin.submitted_at, twin.submission_id) > moment:
            _flag(session, _completed(session, twin.submission_id), submission.id, twin.episodes)


def copies_among(session: Session, evaluations: Collection[UUID]) -> dict[UUID, LogCopyView]:
    """Return what was found of these evaluations."""
    if not evaluations:
        return {}
    rows = session.execute(
        select(LogCopy.evaluation_id, Team.name, LogCopy.episodes, BoardResult.is_copy)
        .join(Submission, Submission.id == LogCopy.earlier_submission_id)
        .join(Team, Team.id == Submission.team_id)
        .join(BoardResult, BoardResult.evaluation_id == LogCopy.evaluation_id)
        .where(among(LogCopy.evaluation_id, evaluations))
    )
    return {
        evaluation_id: LogCopyView(team=team, episodes=episodes, ranked=not is_copy)
        for evaluation_id, team, episodes, is_copy in rows
    }


def count_copied_episodes() -> ScalarSelect[int]:
    """Return how many episodes of a row of `evaluations` have the states of an earlier log, for a query on them."""
    found = select(func.max(LogCopy.episodes)).where(LogCopy.evaluation_id == Evaluation.id)
    return select(func.coalesce(found.correlate(Evaluation).scalar_subquery(), 0)).scalar_subquery()


def _twins(session: Session, evaluation: Evaluation) -> list[_Twin]:
    """Return the submissions of other teams that share states; of equal ones the earliest first."""
    submission, ours, theirs = evaluation.submission, aliased(EpisodeResult), aliased(EpisodeResult)
    shared = (
        select(theirs.submission_digest, func.count(distinct(ours.episode)).label("episodes"))
        .join(
            theirs,
            # Under any number and track: repeats of a start, and tracks that differ in cameras only, have equal states.
            theirs.states_digest == ours.states_digest,
        )
        # Without an env step there are only the states of the reset, which are everybody's.
        .where(*EpisodeKey.of(evaluation, submission).conditions(ours), ours.env_steps > 0)
        .group_by(theirs.submission_digest)
        .subquery()
    )
    rows = session.execute(
        select(Submission.id, Submission.kind, Submission.submitted_at, shared.c.episodes)
        .join(shared, shared.c.submission_digest == Submission.digest)
        .where(Submission.team_id != submission.team_id)
        .order_by(Submission.submitted_at, Submission.id)
    )
    return [
        _Twin(submission_id=found, kind=kind, submitted_at=submitted_at, episodes=episodes)
        for found, kind, submitted_at, episodes in rows
    ]


def _completed(session: Session, submission_id: UUID) -> Collection[Evaluation]:
    return session.scalars(
        select(Evaluation)
        .where(Evaluation.submission_id == submission_id, Evaluation.state == EvaluationState.COMPLETED)
        .order_by(Evaluation.id)
    ).all()


def _flag(session: Session, evaluations: Collection[Evaluation], earlier: UUID, episodes: int) -> None:
    for evaluation in evaluations:
        new = insert(LogCopy).values(evaluation_id=evaluation.id, earlier_submission_id=earlier, episodes=episodes)
        session.execute(
            new.on_conflict_do_update(
                constraint="pk_log_copies",
                set_={"earlier_submission_id": new.excluded.earlier_submission_id, "episodes": new.excluded.episodes},
                where=new.excluded.episodes > LogCopy.episodes,
            )
        )
        if 2 * episodes >= sum(score["episodes"] for score in evaluation.scores or []):
            session.execute(update(BoardResult).where(BoardResult.evaluation_id == evaluation.id).values(is_copy=True))
