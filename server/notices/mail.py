"""E-mails: what a notice says, and how it leaves: over SMTP, or as a file in a folder."""

import smtplib
import ssl
from collections.abc import Mapping
from email.message import EmailMessage
from email.utils import format_datetime
from pathlib import Path
from typing import Any
from urllib.parse import SplitResult, unquote, urlsplit

from ..db.models import Notice
from ..db.states import NoticeKind
from ..settings import Settings
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


def send(notice: Notice, settings: Settings) -> None:
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
