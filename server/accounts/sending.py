"""Sends the notices of the outbox in threads of the server, with pauses that grow from try to try."""

import smtplib
import ssl
import threading
import time
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from datetime import datetime, timedelta
from email.message import EmailMessage
from email.utils import format_datetime
from functools import partial
from pathlib import Path
from typing import Any, TypeVar
from urllib.parse import SplitResult, unquote, urlsplit
from uuid import UUID

import structlog
from sqlalchemy import delete, select
from sqlalchemy.orm import Session

from ..database.clock import read_clock
from ..database.engine import Database
from ..database.models import Notice, Webhook
from ..database.states import NoticeChannel, NoticeKind
from ..settings import Settings
from . import outbox, webhooks
from .webhooks import Undelivered

TIMEOUT_S = 20.0
SUBJECT_LENGTH = 150
_SENTENCES = {
    NoticeKind.ACCEPTED: "Submission {name} to {track_title} was accepted and waits for its evaluation.",
    NoticeKind.FINISHED: "Submission {name} to {track_title} has a score.",
    NoticeKind.FAILED: "The evaluation of submission {name} to {track_title} has ended without a score ({verdict}).",
    NoticeKind.PROMOTED: "{team} takes part in stage {stage_title} of {track_title}.",
    NoticeKind.DEADLINE: "Stage {stage_title} of {track_title} closes at {closes}.",
    NoticeKind.CONFIRMATION: "Please confirm your address for notices.\n\nEnter this code on your team's page, or with "
    "`vitac team confirm-email`: {code}\n\nIf you did not expect this, ignore it: no notices will be sent.",
    NoticeKind.ANNOUNCEMENT: "{title}\n\n{text}",
}


def make_message(notice: Notice, settings: Settings) -> EmailMessage:
    """Return a notice as an e-mail; the same notice has the same Message-ID, by which receivers see a repeat."""
    made = EmailMessage()
    text = _SENTENCES[notice.kind].format_map(_untitled(notice.facts) | notice.facts)
    made["From"] = settings.mail_from
    made["To"] = notice.target
    subject, _, _ = text.partition("\n")  # of an announcement its title
    made["Subject"] = one_line(f"ViTac Arena: {subject}", max_length=SUBJECT_LENGTH)
    made["Date"] = format_datetime(notice.created_at)
    made["Message-ID"] = f"<{notice.id}@{settings.mail_from.rpartition('@')[2]}>"
    made["Auto-Submitted"] = "auto-generated"
    link = f"\n\n{settings.public_url.rstrip('/')}{notice.facts['page']}" if settings.public_url else ""
    stop = (
        "You get this because your team entered this address. "
        "Remove it, or mute this kind of notice, on the team's page."
    )
    made.set_content(f"{text}{link}\n\n-- \n{stop}\n")
    return made


def _untitled(facts: Mapping[str, Any]) -> dict[str, Any]:
    """Return the names of track and stage as their titles, for a notice that an older server wrote."""
    return {f"{name}_title": facts[name] for name in ("track", "stage") if name in facts}


def send_mail(notice: Notice, settings: Settings) -> None:
    """Hand an e-mail over.

    Raises:
        Undelivered: the server of the settings does not take it, or the settings name none.
    """
    if settings.mail_url is None:
        raise Undelivered("VITAC_MAIL_URL is not set, so no e-mail is sent.")
    parts = urlsplit(settings.mail_url.get_secret_value())
    try:
        message = make_message(notice, settings)
        if parts.scheme == "file":
            _write(message, Path(unquote(parts.path)), str(notice.id))
            return
        with _connected(parts) as server:
            if parts.scheme == "smtp+starttls":
                server.starttls(context=ssl.create_default_context())
            if parts.username:
                server.login(unquote(parts.username), unquote(parts.password or ""))
            server.send_message(message)
    except (OSError, smtplib.SMTPException, ValueError, LookupError) as error:
        raise Undelivered(f"{type(error).__name__}: {error}") from error


def one_line(text: str, *, max_length: int) -> str:
    """Return text for a header or a column: one line of at most this length, without control characters."""
    return "".join(character if character.isprintable() else " " for character in text)[:max_length]


def _connected(parts: SplitResult) -> smtplib.SMTP:
    """Return a connection to the server; with `smtps`, one that has a valid certificate of its name."""
    host, port = parts.hostname or "", parts.port or 0
    if parts.scheme == "smtps":
        return smtplib.SMTP_SSL(host, port, timeout=TIMEOUT_S, context=ssl.create_default_context())
    return smtplib.SMTP(host, port, timeout=TIMEOUT_S)


def _write(message: EmailMessage, folder: Path, name: str) -> None:
    """Write it as a whole or not at all; a repeat writes the same file."""
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    draft = folder / f".{name}"
    draft.write_bytes(bytes(message))
    draft.rename(folder / f"{name}.eml")


logger = structlog.get_logger(__name__)

ResultT = TypeVar("ResultT")

MAX_ATTEMPTS = 8
FIRST_PAUSE = timedelta(seconds=30)
"""Pause after the first attempt; each further pause is three times as long, together about 18 hours."""
CLAIMED = timedelta(minutes=2)
"""How long a notice belongs to the process that has begun to send it; longer than any sending takes."""
KEPT = timedelta(days=30)
LOOK_FOR_DEADLINES_EVERY_S = 600.0
PROBLEM_LENGTH = 500
WEBHOOKS_AT_ONCE = 8
"""Only one of them is of the same team: webhooks that hang hold up the further notices of their own team."""
STOPPED_WITHIN_S = 5.0
"""A notice that takes longer than that to send when the server stops is left to the next one."""


@dataclass(frozen=True, kw_only=True)
class Claimed:
    """A notice that this process sends now, and where to."""

    notice: Notice
    address: str
    secret: str


Look = Callable[[], Callable[[], None] | None]
"""Returns what there is to do; None: nothing now."""


class NoticeSender:
    """Threads that send what is due, from `start` to `stop`: one for e-mails, several for webhooks, which may be slow.

    They outlive restarts of the database, and whatever else goes wrong with a notice.
    """

    def __init__(self, database: Database, settings: Settings) -> None:
        self._database = database
        self._settings = settings
        self._stopping = threading.Event()
        self._looked_at = float("-inf")
        self._teams_at_work: dict[NoticeChannel, set[UUID]] = {channel: set() for channel in NoticeChannel}
        looks: dict[str, tuple[Look, int]] = {
            channel.value: (partial(self._next, channel), WEBHOOKS_AT_ONCE if channel is NoticeChannel.WEBHOOK else 1)
            for channel in NoticeChannel
        }
        looks["deadlines"] = (self._look_for_deadlines, 1)
        self._threads = [
            threading.Thread(target=self._repeat, args=[look, turn], name=f"notices-{name}-{number}", daemon=True)
            for name, (look, n_threads) in looks.items()
            for turn in [threading.Lock()]
            for number in range(n_threads)
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

    def _repeat(self, look: Look, turn: threading.Lock) -> None:
        """Look and do what there is; of several threads one looks or waits, while the others are at work."""
        while True:
            with turn:
                if self._stopping.is_set():
                    return
                work = _tried(look)
                if work is None:
                    self._stopping.wait(self._settings.sweep_interval_s)
            if work is not None:
                _tried(work)

    def _next(self, channel: NoticeChannel) -> Callable[[], None] | None:
        teams = self._teams_at_work[channel]
        claimed = claim(self._database, [channel], apart_from=tuple(teams))  # copied: threads that end take teams out
        if claimed is None:
            return None
        teams.add(claimed.notice.team_id)
        return partial(self._send, claimed)

    def _send(self, claimed: Claimed) -> None:
        try:
            send(self._database, self._settings, claimed)
        finally:
            self._teams_at_work[claimed.notice.channel].discard(claimed.notice.team_id)

    def _look_for_deadlines(self) -> None:
        if time.monotonic() - self._looked_at > LOOK_FOR_DEADLINES_EVERY_S:
            with self._database.transaction() as session:
                session.execute(delete(Notice).where(Notice.created_at < read_clock(session) - KEPT))
            with self._database.transaction() as session:
                outbox.announce_deadlines(session)
            self._looked_at = time.monotonic()


def _tried(work: Callable[[], ResultT]) -> ResultT | None:
    """Do something; None where it failed, whatever it is: the next round tries again."""
    try:
        return work()
    except Exception as error:  # noqa: BLE001 - see above
        logger.warning("notices_postponed", error=one_line(repr(error), max_length=PROBLEM_LENGTH))
        return None


def claim(
    database: Database,
    channels: Collection[NoticeChannel] = tuple(NoticeChannel),
    *,
    apart_from: Collection[UUID] = (),
) -> Claimed | None:
    """Return the notice of these channels that has been due for longest, for `send`; None: nothing is due.

    It is claimed in a transaction of its own: killed in between, it is sent again when the claim ends.

    Args:
        database: of the notices.
        channels: of which it may be.
        apart_from: teams whose notices have to wait.
    """
    with database.transaction() as session:
        now = read_clock(session)
        # A notice whose last try was not noted, because its sender was killed, is given up here.
        while (notice := _first_due(session, now, channels, apart_from)) and notice.attempts >= MAX_ATTEMPTS:
            _give_up(notice, now, notice.problem or "The server stopped while it was sending this.")
        if notice is None:
            return None
        notice.attempts += 1
        notice.due_at = now + CLAIMED
        hook = session.get(Webhook, notice.target) if notice.channel is NoticeChannel.WEBHOOK else None
        session.flush()
        return Claimed(
            notice=notice,
            address=hook.address if hook is not None else "",
            secret=hook.secret if hook is not None else "",
        )


def send(database: Database, settings: Settings, claimed: Claimed) -> None:
    """Send a claimed notice. Whatever goes wrong is noted as its problem, so it keeps no others from being sent."""
    try:
        if claimed.notice.channel is NoticeChannel.MAIL:
            send_mail(claimed.notice, settings)
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
    _note(database, claimed.notice, problem and one_line(problem, max_length=PROBLEM_LENGTH))


def _first_due(
    session: Session, now: datetime, channels: Collection[NoticeChannel], apart_from: Collection[UUID]
) -> Notice | None:
    due = Notice.due_at <= now, Notice.sent_at.is_(None), Notice.given_up_at.is_(None)
    wanted = Notice.channel.in_(channels), Notice.team_id.not_in(apart_from)
    query = select(Notice).where(*due, *wanted).order_by(Notice.due_at, Notice.id).limit(1)
    return session.scalar(query.with_for_update(skip_locked=True))


def _give_up(notice: Notice, now: datetime, problem: str) -> None:
    notice.given_up_at, notice.problem = now, problem
    logger.warning("notice_given_up", notice=str(notice.id), channel=notice.channel.value, problem=problem)


def _note(database: Database, sent: Notice, problem: str | None) -> None:
    with database.transaction() as session:
        now = read_clock(session)
        notice = session.get(Notice, sent.id, with_for_update=True)
        if notice is None or notice.attempts != sent.attempts:
            return  # removed, or sent by somebody else after our claim had ended
        notice.problem = problem
        if problem is None:
            notice.sent_at = now
        elif notice.attempts >= MAX_ATTEMPTS:
            _give_up(notice, now, problem)
        else:
            notice.due_at = now + FIRST_PAUSE * 3 ** (notice.attempts - 1)
