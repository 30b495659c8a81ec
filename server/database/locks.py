"""Locks on rows that several transactions change, taken in one order; called by queue, evaluations and submissions."""

from collections.abc import Callable
from enum import IntEnum
from typing import TypeVar
from uuid import UUID

from psycopg.errors import LockNotAvailable
from sqlalchemy import Connection, Select, select, text
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


class AdvisoryLock(IntEnum):
    """Work that one process of the service does at a time; the first bytes of each key spell `vita`."""

    SCHEMA_UPGRADE = 0x7669_7461_6301  # of several processes that start at once, one migrates and the others wait
    SWEEP = 0x7669_7461_6302  # one sweep at a time is enough
    SUPERSEDE = 0x7669_7461_6303  # two processes would begin the same evaluation again twice
    PLAYBACK_OF_REQUESTER = 0x7669_7461_6304  # two requests at once would exceed the limits
    PLAYBACK_OF_EPISODE = 0x7669_7461_6305  # two requests at once would make the same playback twice
    STORED_FILE = 0x7669_7461_6306  # a file must not be removed while it is uploaded again
    LISTS_OF_TEAM = 0x7669_7461_6308  # two claims at once would play a public and a sealed list side by side
    RECEIPTS = 0x7669_7461_6307  # two receipts at once would follow the same one


def try_lock(session: Session, lock: AdvisoryLock) -> bool:
    """Take a lock until the end of the transaction; whether nobody else holds it."""
    return bool(session.scalar(text("SELECT pg_try_advisory_xact_lock(:key)"), {"key": lock.value}))


def wait_for_lock(connection: Connection, lock: AdvisoryLock) -> None:
    """Take a lock until the connection is closed, after whoever holds it now."""
    connection.execute(text("SELECT pg_advisory_lock(:key)"), {"key": lock.value})


def wait_for_turn(session: Session, lock: AdvisoryLock, name: str) -> None:
    """Take the lock of a name until the end of the transaction, after whoever holds it now."""
    session.execute(
        text("SELECT pg_advisory_xact_lock(hashtextextended(:name, :key))"), {"name": name, "key": lock.value}
    )
