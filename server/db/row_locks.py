"""Locks on rows that several transactions change, taken in one order; called by queue, evaluations and submissions."""

from collections.abc import Callable
from typing import TypeVar
from uuid import UUID

from psycopg.errors import LockNotAvailable
from sqlalchemy import Select, select, text
from sqlalchemy.exc import OperationalError
from sqlalchemy.orm import Session

from .models import Evaluation

ResultT = TypeVar("ResultT")

LOCK_WAIT = "100ms"
"""How long work that can be done later waits for a lock; running transactions hold theirs for a few milliseconds."""


def lock_evaluation(session: Session, evaluation_id: UUID) -> Evaluation:
    """Return the evaluation, locked. Always locked before its shards, so that no two transactions wait for each other.

    The lock leaves foreign keys alone: storing an episode mostly only holds its shard and refers to the evaluation.
    """
    return session.scalars(_evaluation(evaluation_id).with_for_update(key_share=True)).one()


def try_lock_evaluation(session: Session, evaluation_id: UUID) -> Evaluation | None:
    """Return the evaluation, locked; None where somebody else holds it, without waiting for them."""
    return session.scalars(_evaluation(evaluation_id).with_for_update(key_share=True, skip_locked=True)).one_or_none()


def unless_held(session: Session, work: Callable[[], ResultT]) -> ResultT | None:
    """Return what `work` returns; None, with nothing of it done, where somebody else holds a row that it needs."""
    try:
        with session.begin_nested():
            session.execute(text(f"SET LOCAL lock_timeout = '{LOCK_WAIT}'"))
            result = work()
            session.flush()
            session.execute(text("SET LOCAL lock_timeout TO DEFAULT"))
    except OperationalError as error:
        if not isinstance(error.orig, LockNotAvailable):
            raise
        return None
    return result


def _evaluation(evaluation_id: UUID) -> Select[Evaluation]:
    return select(Evaluation).where(Evaluation.id == evaluation_id).execution_options(populate_existing=True)
