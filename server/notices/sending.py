"""Sends the notices of the outbox in a thread of the server, with pauses that grow from try to try."""

import threading
import time
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

import structlog
from sqlalchemy import delete, select
from sqlalchemy.exc import SQLAlchemyError
from vitac.server.db.engine import Database
from vitac.server.db.models import Notice, Webhook
from vitac.server.db.states import NoticeChannel
from vitac.server.notices import deadlines, mail, webhooks
from vitac.server.notices.webhooks import Undelivered
from vitac.server.settings import Settings

logger = structlog.get_logger(__name__)

MAX_ATTEMPTS = 8
FIRST_PAUSE = timedelta(seconds=30)
"""After the first try; each further pause is three times as long, together about 18 hours."""
CLAIMED = timedelta(minutes=2)
"""So long nobody else sends a notice that somebody has begun to send; longer than any sending takes."""
KEPT = timedelta(days=30)
LOOK_FOR_DEADLINES_EVERY_S = 600.0


@dataclass(frozen=True, kw_only=True)
class _Claimed:
    """A notice that this process sends now, and where to."""

    notice: Notice
    address: str
    secret: str


class NoticeSender:
    """A thread that sends what is due, from `start` to `stop`; it outlives restarts of the database."""

    def __init__(self, database: Database, settings: Settings) -> None:
        self._database = database
        self._settings = settings
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="notices", daemon=True)

    def start(self) -> None:
        """Begin."""
        self._thread.start()

    def stop(self) -> None:
        """End after the notice at work."""
        self._stopping.set()
        self._thread.join()

    def _run(self) -> None:
        looked_at = float("-inf")
        while not self._stopping.is_set():
            try:
                if time.monotonic() - looked_at > LOOK_FOR_DEADLINES_EVERY_S:
                    with self._database.transaction() as session:
                        deadlines.announce_near(session)
                        session.execute(delete(Notice).where(Notice.created_at < datetime.now(UTC) - KEPT))
                    looked_at = time.monotonic()
                while not self._stopping.is_set() and send_one(self._database, self._settings):
                    pass
            except SQLAlchemyError as error:
                logger.warning("notices_postponed", error=" ".join(str(error).split())[:300])
            self._stopping.wait(self._settings.sweep_interval_s)


def send_one(database: Database, settings: Settings) -> bool:
    """Send the notice that has been due for longest; whether there was one.

    It is claimed first, in a transaction of its own: killed in between, it is sent again when the claim ends.
    """
    claimed = _claim(database)
    if claimed is None:
        return False
    try:
        if claimed.notice.channel is NoticeChannel.MAIL:
            mail.send(claimed.notice, settings)
        else:
            webhooks.send(
                claimed.notice, claimed.address, claimed.secret, inside_allowed=settings.webhooks_may_lead_inside
            )
        problem = None
    except Undelivered as error:
        problem = str(error)[:500]
    _note(database, claimed.notice, problem)
    return True


def _claim(database: Database) -> _Claimed | None:
    now = datetime.now(UTC)
    with database.transaction() as session:
        found = session.scalar(
            select(Notice)
            .where(Notice.due_at <= now, Notice.sent_at.is_(None), Notice.given_up_at.is_(None))
            .order_by(Notice.due_at, Notice.id)
            .limit(1)
            .with_for_update(skip_locked=True)
        )
        if found is None:
            return None
        found.attempts += 1
        found.due_at = now + CLAIMED
        hook = session.get(Webhook, found.target) if found.channel is NoticeChannel.WEBHOOK else None
        session.flush()
        return _Claimed(
            notice=found,
            address=hook.address if hook is not None else "",
            secret=hook.secret if hook is not None else "",
        )


def _note(database: Database, sent: Notice, problem: str | None) -> None:
    now = datetime.now(UTC)
    with database.transaction() as session:
        found = session.get(Notice, sent.id, with_for_update=True)
        if found is None or found.attempts != sent.attempts:
            return  # removed, or sent by somebody else after our claim had ended
        found.problem = problem
        if problem is None:
            found.sent_at = now
        elif found.attempts >= MAX_ATTEMPTS:
            found.given_up_at = now
            logger.warning("notice_given_up", notice=str(found.id), channel=found.channel.value, problem=problem)
        else:
            found.due_at = now + FIRST_PAUSE * 3 ** (found.attempts - 1)
