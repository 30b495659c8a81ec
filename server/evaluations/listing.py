"""Evaluations as organizers read them: a list of them, one with its shards."""

from uuid import UUID

from sqlalchemy import ColumnElement, select
from sqlalchemy.orm import Session, defer, joinedload

from ..database.models import Evaluation, Shard, Submission
from ..database.states import EvaluationState
from ..errors import not_found
from ..principals import CONSOLE
from ..queue.workers import fleet
from ..settings import Settings
from ..views.evaluations import EvaluationDetailView, EvaluationRowView, ShardView
from .copies import count_copied_episodes
from .history import count_differing_episodes
from .scores import combined_score
from .view import EvaluationRows, evaluation_view, verdict_view


def find(session: Session, evaluation_id: UUID) -> Evaluation:
    """Return the evaluation of that id.

    Raises:
        ServiceError: there is none.
    """
    evaluation = session.get(Evaluation, evaluation_id)
    if evaluation is None:
        raise not_found("evaluation", evaluation_id)
    return evaluation


def list_evaluations(
    session: Session, *conditions: ColumnElement[bool], state: EvaluationState | None = None, limit: int
) -> list[EvaluationRowView]:
    """Return the newest evaluations (in a state, on conditions), newest first."""
    query = (
        select(Evaluation, count_differing_episodes(), count_copied_episodes())
        .options(defer(Evaluation.log_tail), joinedload(Evaluation.submission).joinedload(Submission.team))
        .where(*conditions)
        .order_by(Evaluation.created_at.desc(), Evaluation.id)
        .limit(limit)
    )
    if state is not None:
        query = query.where(Evaluation.state == state)
    return [_row(evaluation, differing, copied) for evaluation, differing, copied in session.execute(query)]


def show_evaluation(session: Session, settings: Settings, evaluation_id: UUID) -> EvaluationDetailView:
    """Return an evaluation with its shards.

    Raises:
        ServiceError: there is none.
    """
    evaluation = find(session, evaluation_id)
    workers = fleet(session, settings).alive
    rows = EvaluationRows.read(session, [evaluation], CONSOLE, with_output=True)
    return EvaluationDetailView(
        **dict(evaluation_view(evaluation, workers, rows)),
        submission_id=evaluation.submission_id,
        team=evaluation.submission.team.name,
        track=evaluation.submission.track,
        shards=[_shard(shard) for shard in evaluation.shards],
    )


def _row(evaluation: Evaluation, differing: int, copied: int) -> EvaluationRowView:
    combined = combined_score(evaluation)
    return EvaluationRowView.from_row(
        evaluation,
        team=evaluation.submission.team.name,
        track=evaluation.submission.track,
        success_rate=combined.success_rate if combined else None,
        mean_steps=combined.mean_steps if combined else None,
        verdict=verdict_view(evaluation),
        differing_episodes=differing,
        copied_episodes=copied,
    )


def _shard(shard: Shard) -> ShardView:
    return ShardView.model_validate(shard, from_attributes=True)
