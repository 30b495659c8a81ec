"""Locks on rows that several transactions change, taken in one order; called by queue, evaluations and submissions."""

from uuid import UUID

from sqlalchemy import select
from sqlalchemy.orm import Session

from .models import Evaluation


def lock_evaluation(session: Session, evaluation_id: UUID) -> Evaluation:
    """Return the evaluation, locked. Always locked before its shards, so that no two transactions wait for each other.

    The lock leaves foreign keys alone: storing an episode only holds its shard and refers to the evaluation.
    """
    return session.scalars(
        select(Evaluation)
        .where(Evaluation.id == evaluation_id)
        .with_for_update(key_share=True)
        .execution_options(populate_existing=True)
    ).one()
