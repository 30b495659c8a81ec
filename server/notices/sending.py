"""Sends the notices of the outbox in threads of the server, with pauses that grow from try to try."""

import threading
import time
from collections.abc import Callable, Collection
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from functools import partial

import structlog
from sqlalchemy import delete, select
from sqlalchemy.orm import Session
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
PROBLEM_LENGTH = 500
STOPPED_WITHIN_S = 5.0
"""A notice that takes longer than that to send when the server stops is left to the next one."""


@dataclass(frozen=True, kw_only=True)
class _Claimed:
    """A notice that this process sends now, and where to."""

    notice: Notice
    address: str
    secret: str


class NoticeSender:
    """Threads that send what is due, from `start` to `stop`, one for each channel: slow webhooks hold up no e-mails.

    They outlive restarts of the database, and whatever else goes wrong with a notice.
    """

    def __init__(self, database: Database, settings: Settings) -> None:
        self._database = database
        self._settings = settings
        self._stopping = threading.Event()
        self._looked_at = float("-inf")
        works: dict[str, Callable[[], None]] = {
            f"notices-{channel}": partial(self._send_due, channel) for channel in NoticeChannel
        }
        works["notices-deadlines"] = self._look_for_deadlines
        self._threads = [
            threading.Thread(target=self._repeat, args=[work], name=name, daemon=True) for name, work in works.items()
        ]

    def start(self) -> None:
        """Begin."""
        for thread in self._threads:
            thread.start()

    def stop(self) -> None:
        """End after the notices at work, or without them when they take too long."""
        self._stopping.set()
        until = time.monotonic() + STOPPED_WITHIN_S
        for thread in self._threads:
            thread.join(max(0.0, until - time.monotonic()))

    def _repeat(self, work: Callable[[], None]) -> None:
        while not self._stopping.is_set():
            try:
                work()
            except Exception as error:  # noqa: BLE001 - whatever it is, the next round tries again
                logger.warning("notices_postponed", error=mail.one_line(repr(error), max_length=PROBLEM_LENGTH))
            self._stopping.wait(self._settings.sweep_interval_s)

    def _send_due(self, channel: NoticeChannel) -> None:
        while not self._stopping.is_set() and send_one(self._database, self._settings, [channel]):
            pass

    def _look_for_deadlines(self) -> None:
        if time.monotonic() - self._looked_at > LOOK_FOR_DEADLINES_EVERY_S:
            with self._database.transaction() as session:
                session.execute(delete(Notice).where(Notice.created_at < datetime.now(UTC) - KEPT))
            with self._database.transaction() as session:
                deadlines.announce_near(session)
            self._looked_at = time.monotonic()


def send_one(
    database: Database, settings: Settings, channels: Collection[NoticeChannel] = tuple(NoticeChannel)
) -> bool:
    """Send the notice of these channels that has been due for longest; whether there was one.

    It is claimed first, in a transaction of its own: killed in between, it is sent again when the claim ends.
    Whatever goes wrong with it is noted as its problem, so that no notice keeps the others from being sent.
    """
    claimed = _claim(database, channels)
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
        problem = str(error)
    except Exception as error:  # noqa: BLE001 - addresses are people's own, so anything can go wrong
        problem = f"{type(error).__name__}: {error}"
        logger.warning("notice_not_sent", notice=str(claimed.notice.id), problem=problem[:PROBLEM_LENGTH])
    _note(database, claimed.notice, problem and mail.one_line(problem, max_length=PROBLEM_LENGTH))
    return True


def _claim(database: Database, channels: Collection[NoticeChannel] = tuple(NoticeChannel)) -> _Claimed | None:
    now = datetime.now(UTC)
    with database.transaction() as session:
        # A notice whose last try was not noted, because its sender was killed, is given up here.
        while (found := _first_due(session, now, channels)) is not None and found.attempts >= MAX_ATTEMPTS:
            _give_up(found, now, found.problem or "The server ended while it was sending this.")
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


def _first_due(session: Session, now: datetime, channels: Collection[NoticeChannel]) -> Notice | None:
    due = Notice.due_at <= now, Notice.sent_at.is_(None), Notice.given_up_at.is_(None), Notice.channel.in_(channels)
    query = select(Notice).where(*due).order_by(Notice.due_at, Notice.id).limit(1)
    return session.scalar(query.with_for_update(skip_locked=True))


def _give_up(notice: Notice, now: datetime, problem: str) -> None:
    notice.given_up_at, notice.problem = now, problem
    logger.warning("notice_given_up", notice=str(notice.id), channel=notice.channel.value, problem=problem)


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
            _give_up(found, now, problem)
        else:
            found.due_at = now + FIRST_PAUSE * 3 ** (found.attempts - 1)
