"""Boards as they were last made: cached by this process until a new entry changes them.

An entry never changes, since a completed evaluation and its submission's name do not. So the ids of the entries, and
under which names teams are shown, say whether a board that was made before is still right.
"""

import hashlib
from collections.abc import Callable, Hashable, Iterable
from dataclasses import dataclass
from functools import cache, cached_property
from importlib.metadata import version
from typing import Any, Generic, TypeVar, cast

from sqlalchemy import delete, func, select
from sqlalchemy.orm import Session
from vitac.evaluator.version import evaluator_version

from ..cache import Cache
from ..database.models import BoardChange
from ..views.leaderboards import LeaderboardView, LogBoardsView

PAGE_ENTRIES = 40
"""Number of entries of a page that the API sends: about 100 kB."""

BoardT = TypeVar("BoardT", LeaderboardView, LogBoardsView)


@dataclass(frozen=True, kw_only=True)
class MadeBoard(Generic[BoardT]):
    """A board, and pages of it as the API sends them.

    Attributes:
        view: the board.
        names: changes whenever a team is shown under another name; entries from before then are not used again.
    """

    view: BoardT
    names: str = ""

    def body(self, after: int = 0, limit: int = PAGE_ENTRIES) -> bytes:
        """Return a page of the board as JSON; the first one is kept."""
        return self._first if (after, limit) == (0, PAGE_ENTRIES) else self._page(after, limit)

    @cached_property
    def _first(self) -> bytes:
        return self._page(0, PAGE_ENTRIES)

    def _page(self, after: int, limit: int) -> bytes:
        return self.view.cut(after, limit).model_dump_json().encode()


class MadeBoards(Generic[BoardT]):
    """Keeps each board as it was last made."""

    def __init__(self) -> None:
        self._made: dict[Hashable, MadeBoard[BoardT]] = {}

    def get(
        self,
        board: Hashable,
        revision: str,
        make: Callable[[BoardT | None], BoardT],
        *,
        names: str = "",
    ) -> MadeBoard[BoardT]:
        """Return the board of that revision, made out of the stored one where that is another one."""
        made = self._made.get(board)
        if made is None or made.view.revision != revision:
            last = made.view if made is not None and made.names == names else None
            made = MadeBoard(view=make(last), names=names)
            self._made[board] = made
        return made


@cache
def read_release() -> str:
    """Return the version of what makes the boards; its file is long, and every look at a board asks."""
    return version("vitac-arena")


def compute_revision(board: str, entries: Iterable[object]) -> str:
    """Return what changes with everything that a board shows: its entries, their order, the software that made it.

    Args:
        board: its name.
        entries: in their order, each as what identifies it and its place when printed.
    """
    parts = [read_release(), evaluator_version(), board, *map(str, entries)]
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()[:32]


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
