"""Follows submissions until their evaluations have ended; called by the event streams of API and pages.

The database says which submission has changed. All streams of one account on the same submission share each look at it.
"""

import asyncio
from collections.abc import AsyncGenerator, AsyncIterator, Awaitable, Callable, Iterator
from contextlib import asynccontextmanager, contextmanager, suppress
from functools import partial
from typing import Any, TypeVar, cast
from uuid import UUID

import psycopg
import structlog
from psycopg.conninfo import make_conninfo

from ..database.engine import Database
from ..database.states import TERMINAL_EVALUATION_STATES
from ..principals import Principal
from ..settings import Settings
from ..views.submissions import SubmissionView
from .listing import get

logger = structlog.get_logger(__name__)
ResultT = TypeVar("ResultT")

CHANNEL = "vitac_submissions"
PAUSE_S = 0.5
"""Changes that follow each other within this time are looked at together."""
LOOK_AGAIN_S = 15.0
"""Time after which a submission is read without a change of its own: its place in the queue moves, too."""
RECONNECT_PAUSE_S = 1.0
_KEEPALIVES: dict[str, Any] = {
    "keepalives_idle": 10,
    "keepalives_interval": 5,
    "keepalives_count": 3,
    "connect_timeout": 15,
}


class Watched:
    """One submission that somebody follows."""

    def __init__(self) -> None:
        self.watchers = 0
        self.version = 0
        self._changed = asyncio.Event()
        self._looks: dict[str, tuple[int, asyncio.Future[Any]]] = {}

    def change(self) -> None:
        """Wake all who follow it."""
        self.version += 1
        self._changed.set()
        self._changed = asyncio.Event()

    async def look(self, account: str, make: Callable[[], Awaitable[ResultT]]) -> ResultT:
        """Return what `make` gives, made once for all of an account that look at the same version."""
        latest = self._looks.get(account)
        if latest is None or latest[0] != self.version or latest[1].cancelled():
            latest = self._looks[account] = self.version, asyncio.ensure_future(make())
        return cast("ResultT", await asyncio.shield(latest[1]))

    async def wait(self, seen: int) -> None:
        """Wait until there is another version than the one seen, which is so after a while at the latest."""
        if self.version == seen:
            with suppress(TimeoutError):
                await asyncio.wait_for(self._changed.wait(), LOOK_AGAIN_S)
            if self.version == seen:
                self.change()
        await asyncio.sleep(PAUSE_S)


class SubmissionWatch:
    """Tells the streams of a process which submissions have changed, over one connection of its own."""

    def __init__(self) -> None:
        self._watched: dict[UUID, Watched] = {}

    @contextmanager
    def of(self, submission_id: UUID) -> Iterator[Watched]:
        """Return the submission to follow while the block runs."""
        watched = self._watched.setdefault(submission_id, Watched())
        watched.watchers += 1
        try:
            yield watched
        finally:
            watched.watchers -= 1
            if not watched.watchers:
                self._watched.pop(submission_id, None)

    @asynccontextmanager
    async def listening(self, address: str) -> AsyncIterator[None]:
        """Listen to the database while the block runs; connect again whenever it went away."""
        task = asyncio.create_task(self._listen(address))
        try:
            yield
        finally:
            task.cancel()
            with suppress(asyncio.CancelledError):
                await task

    async def _listen(self, address: str) -> None:
        while True:
            try:
                connecting = psycopg.AsyncConnection.connect(make_conninfo(address, **_KEEPALIVES), autocommit=True)
                async with await connecting as connection:
                    await connection.execute(f"LISTEN {CHANNEL}")
                    for watched in self._watched.values():
                        watched.change()  # nobody was notified of what happened meanwhile
                    async for notification in connection.notifies():
                        self._note(notification.payload)
            except psycopg.Error as error:
                logger.warning("changes_not_heard", error=" ".join(str(error).split())[:200])
            await asyncio.sleep(RECONNECT_PAUSE_S)

    def _note(self, payload: str) -> None:
        watched = self._watched.get(UUID(payload))
        if watched is not None:
            watched.change()


async def watch(
    database: Database, settings: Settings, by: Principal, submission_id: UUID, changes: SubmissionWatch
) -> AsyncGenerator[SubmissionView, None]:
    """Yield the submission now and after each change, until its evaluation has ended.

    Raises:
        ServiceError: there is no such submission.
    """

    def read() -> SubmissionView:
        with database.transaction() as session:
            return get(session, settings, by, submission_id)

    last = None
    with changes.of(submission_id) as watched:
        while True:
            seen = watched.version
            view = await watched.look(by.account, partial(asyncio.to_thread, read))
            if view != last:
                yield view
            if view.evaluation.state in TERMINAL_EVALUATION_STATES:
                return
            last = view
            await watched.wait(seen)
