"""Webhooks of teams: added and removed, and one notice sent to one of them, signed and without following redirects."""

import hashlib
import hmac
import http.client
import json
import secrets
import socket
import ssl
import threading
import time
from contextlib import suppress
from urllib.parse import SplitResult
from uuid import UUID

from sqlalchemy import delete, func, select
from sqlalchemy.orm import Session

from ..audit import record
from ..db.models import Notice, Team, Webhook
from ..errors import ProblemCode, ServiceError, not_found
from ..principals import Principal
from ..teams import teams
from ..views.notices import NewWebhookView, WebhookView
from . import addresses

MAX_WEBHOOKS = 5
TIMEOUT_S = 10.0
WHOLE_TIMEOUT_S = 20.0
"""A receiver that answers byte by byte is cut off after this time."""


class Undelivered(Exception):
    """A notice did not arrive; the message says why."""


def add(session: Session, by: Principal, team: Team, address: str, *, inside_allowed: bool) -> NewWebhookView:
    """Send a team's notices to an address from now on; the secret that signs them is shown once.

    Raises:
        ServiceError: not the captain, the address cannot be used, or the team has reached its limit.
    """
    by.require_leader(team.id)
    addresses.checked(address, inside_allowed=inside_allowed)
    teams.lock(session, team)
    if (session.scalar(select(func.count()).where(Webhook.team_id == team.id)) or 0) >= MAX_WEBHOOKS:
        raise ServiceError(
            ProblemCode.INVALID_REQUEST, f"{team.name} has {MAX_WEBHOOKS} webhooks, no more are possible."
        )
    made = Webhook(team_id=team.id, address=address, secret=secrets.token_hex(32))
    session.add(made)
    session.flush()
    record(session, by, "webhook.add", f"team:{team.id}", {"webhook": str(made.id), "address": address})
    return NewWebhookView(id=made.id, address=made.address, created_at=made.created_at, secret=made.secret)


def remove(session: Session, by: Principal, team: Team, webhook_id: UUID) -> None:
    """Send no further notices to a webhook.

    Raises:
        ServiceError: not the captain, or the team has no such webhook.
    """
    by.require_leader(team.id)
    found = session.get(Webhook, webhook_id)
    if found is None or found.team_id != team.id:
        raise not_found("webhook", webhook_id)
    before = {"webhook": str(found.id), "address": found.address}
    session.execute(delete(Notice).where(Notice.target == str(found.id), Notice.sent_at.is_(None)))
    session.delete(found)
    record(session, by, "webhook.remove", f"team:{team.id}", {"webhook": None}, before=before)


def list_webhooks(session: Session, by: Principal, team: Team) -> list[WebhookView]:
    """Return the webhooks of a team, without their secrets.

    Raises:
        ServiceError: not the captain.
    """
    by.require_leader(team.id)
    found = session.scalars(select(Webhook).where(Webhook.team_id == team.id).order_by(Webhook.created_at, Webhook.id))
    return [WebhookView.model_validate(one, from_attributes=True) for one in found]


def make_body(notice: Notice) -> bytes:
    """Return what a webhook gets: the same bytes each time a notice is sent."""
    content = {
        "id": str(notice.id),
        "kind": notice.kind.value,
        "subject": notice.subject,
        "at": notice.created_at.isoformat(),
        "facts": notice.facts,
    }
    return json.dumps(content, sort_keys=True, separators=(",", ":")).encode()


def signature(secret: str, sent_at_s: int, body: bytes) -> str:
    """Return HMAC-SHA256 over `TIME.BODY`; the time keeps an old request from counting again."""
    return "sha256=" + hmac.new(secret.encode(), f"{sent_at_s}.".encode() + body, hashlib.sha256).hexdigest()


def send(notice: Notice, address: str, secret: str, *, inside_allowed: bool) -> None:
    """Post a notice.

    Raises:
        Undelivered: the address leads inside, does not answer, or answers with anything but 2xx.
    """
    body, now = make_body(notice), int(time.time())
    headers = {
        "Content-Type": "application/json",
        "User-Agent": "ViTac-Arena",
        "Vitac-Notice-Id": str(notice.id),
        "Vitac-Time": str(now),
        "Vitac-Signature": signature(secret, now, body),
    }
    try:
        parts = addresses.checked(address, inside_allowed=inside_allowed)
        status = _post(parts, body, headers, inside_allowed=inside_allowed)
    except (OSError, http.client.HTTPException, ServiceError, UnicodeError) as error:
        raise Undelivered(f"{type(error).__name__}: {error}") from error
    if not 200 <= status < 300:
        raise Undelivered(f"It answered with status {status}, expected 2xx.")


def _post(parts: SplitResult, body: bytes, headers: dict[str, str], *, inside_allowed: bool) -> int:
    host, secure = parts.hostname or "", parts.scheme == "https"
    port = parts.port or (443 if secure else 80)
    family, where = addresses.resolved(host, port, inside_allowed=inside_allowed)
    opened = socket.socket(family, socket.SOCK_STREAM)
    cut_off = threading.Timer(WHOLE_TIMEOUT_S, lambda: _shut(opened))  # whichever is open then: see below
    cut_off.daemon = True
    cut_off.start()
    try:
        opened.settimeout(TIMEOUT_S)
        opened.connect(where)
        connection = http.client.HTTPConnection(host, port)
        if secure:
            # This takes the connection away from the socket before, so the handshake comes after the new one is known.
            opened = ssl.create_default_context().wrap_socket(
                opened, server_hostname=host, do_handshake_on_connect=False
            )
            opened.do_handshake()
        connection.sock = opened
        target = (parts.path or "/") + (f"?{parts.query}" if parts.query else "")
        connection.request("POST", target, body=body, headers=headers)
        return connection.getresponse().status
    finally:
        cut_off.cancel()
        opened.close()


def _shut(opened: socket.socket) -> None:
    with suppress(OSError):  # it may have ended by itself meanwhile
        socket.socket.shutdown(
            opened, socket.SHUT_RDWR
        )  # that of an encrypted one would let its reader continue unencrypted
