"""Locks on rows that several transactions change, taken in one order; called by queue, evaluations and submissions."""

from uuid import UUID

from sqlalchemy import Select, select
from sqlalchemy.orm import Session

from .models import Evaluation


def lock_evaluation(session: Session, evaluation_id: UUID) -> Evaluation:
    """Return the evaluation, locked. Always locked before its shards, so that no two transactions wait for each other.

    The lock leaves foreign keys alone: storing an episode only holds its shard and refers to the evaluation.
    """
    return session.scalars(_evaluation(evaluation_id).with_for_update(key_share=True)).one()


def try_lock_evaluation(session: Session, evaluation_id: UUID) -> Evaluation | None:
    """Return the evaluation, locked; None where somebody else holds it, without waiting for them."""
    return session.scalars(_evaluation(evaluation_id).with_for_update(key_share=True, skip_locked=True)).one_or_none()


def _evaluation(evaluation_id: UUID) -> Select[Evaluation]:
    return select(Evaluation).where(Evaluation.id == evaluation_id).execution_options(populate_existing=True)
