"""Keeps what is read of the tables behind the boards until these change; called by the boards and for places.

Triggers note each change of these tables (`BoardChange`), so one small statement says whether what was read before is
still right. That holds in every transaction: it sees the notes of exactly those changes that it sees.
"""

from collections.abc import Callable, Hashable
from typing import Any, TypeVar, cast

from sqlalchemy import delete, func, select
from sqlalchemy.orm import Session
from vitac.evaluator.version import evaluator_version

from ..cache import Cache
from ..db.models import BoardChange

ValueT = TypeVar("ValueT")

NOTES_KEPT = 1000
"""Number of newest notes that stay, which one statement reads within a fraction of a millisecond."""

_SEEN = select(func.count(), func.sum(BoardChange.mark))
"""Marks are random: other changes do not have the same number and sum. A copy of a database has them, though."""

_cache: Cache[Hashable, Any] = Cache(at_most=200)


def kept_until_change(session: Session, key: Hashable, read: Callable[[], ValueT]) -> ValueT:
    """Return what `read` returns, which is called only where the tables behind the boards have changed since.

    Args:
        session: of the transaction, in which `read` reads these tables and nothing else.
        key: all that the value depends on besides.
        read: reads the value, which nobody may change.
    """
    seen = session.execute(_SEEN).one()
    return cast(ValueT, _cache.get((session.get_bind().engine.url, *seen, evaluator_version(), key), read))


def forget_old_notes(session: Session) -> None:
    """Remove all but the newest notes; whatever is cached is read again."""
    newest = select(func.max(BoardChange.id)).scalar_subquery()
    session.execute(delete(BoardChange).where(BoardChange.id <= newest - NOTES_KEPT))
