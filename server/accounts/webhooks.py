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
from ipaddress import IPv4Address, ip_address, ip_network
from typing import Any, Final
from urllib.parse import SplitResult, urlsplit
from uuid import UUID

from sqlalchemy import delete, func, select
from sqlalchemy.orm import Session

from ..audit import record
from ..database.models import Notice, Team, Webhook
from ..errors import ProblemCode, ServiceError, not_found
from ..principals import Principal
from ..views.correspondence import NewWebhookView, WebhookView
from . import teams

MAX_LENGTH = 500
_PORTS: Final = (443, 8443)
"""Those of HTTPS: a notice is not to be a message to a service of another kind."""
LOOKED_UP_WITHIN_S = 2.0
"""A host that is not found within this time may be named; where it leads is looked at with each notice."""
_LOOK_UPS = threading.BoundedSemaphore(4)
"""Hosts that are looked up at the same time; name servers of others may take long to answer."""
_INTERNET_6 = ip_network("2000::/3")
"""What of version 6 is given out to networks; loopback, mapped (`::ffff:`), NAT64 and local addresses are outside."""
_NOT_PUBLIC: Final = tuple(
    map(
        ip_network,
        (
            *("0.0.0.0/8", "10.0.0.0/8", "100.64.0.0/10", "127.0.0.0/8", "169.254.0.0/16", "172.16.0.0/12"),
            *("192.0.0.0/24", "192.0.2.0/24", "192.88.99.0/24", "192.168.0.0/16", "198.18.0.0/15", "198.51.100.0/24"),
            *("203.0.113.0/24", "224.0.0.0/4", "240.0.0.0/4"),
            "168.63.129.16/32",  # where a cloud's virtual machines reach what manages them
            "2001::/23",  # Teredo, ORCHID, benchmarks
            *("2001:db8::/32", "3fff::/20"),  # documentation
            "2002::/16",  # 6to4: stands for an address of version 4
        ),
    )
)
"""Special-purpose networks of IANA's registries, and what leads to another address. Not `ipaddress.is_global`, which
changes with Python's version: that of 3.11 takes `fec0::` and `3fff::` for public."""
SocketAddress = tuple[int, tuple[Any, ...]]
"""Address family, and what a socket connects to."""


def check_address(address: str, *, inside_allowed: bool, what: str = "The webhook's address") -> SplitResult:
    """Return the parts of an address that somebody gives.

    Args:
        address: as it was given.
        inside_allowed: whether hosts inside, and unencrypted connections, may be named.
        what: is given, for the message.

    Raises:
        ServiceError: it cannot be used; where the name of a host leads is looked at by `require_public`, and with each
            notice.
    """
    try:
        parts = urlsplit(address)
        port = parts.port
    except ValueError as error:
        raise _invalid(what, address, str(error)) from error
    if len(address) > MAX_LENGTH or not address.isascii() or not address.isprintable() or " " in address:
        raise _invalid(what, address, f"expected at most {MAX_LENGTH} printable ASCII characters")
    schemes = ("https", "http") if inside_allowed else ("https",)
    if parts.scheme not in schemes or not parts.hostname or port == 0:
        raise _invalid(what, address, f"expected {' or '.join(schemes)}://HOST/...")
    if parts.username is not None or parts.password is not None or parts.fragment:
        raise _invalid(what, address, "expected an address without user, password and fragment")
    if not inside_allowed and not _may_be_public(parts.hostname):
        raise _invalid(what, address, f"{parts.hostname} is not an address of the public internet")
    if not inside_allowed and (port or 443) not in _PORTS:
        raise _invalid(what, address, f"expected port {' or '.join(map(str, _PORTS))}, got {port}")
    return parts


def require_public(address: str) -> None:
    """Refuse an address whose host leads inside; a host that is not found, or not soon, may be named.

    No transaction is open meanwhile.

    Raises:
        ServiceError: as `checked`, or the host leads inside.
    """
    parts, problems = check_address(address, inside_allowed=False), list[str]()

    def look_up() -> None:
        try:
            resolve_address(parts.hostname or "", parts.port or 443, inside_allowed=False)
        except PermissionError as error:
            problems.append(str(error))
        except (OSError, UnicodeError):
            pass
        finally:
            _LOOK_UPS.release()

    if _LOOK_UPS.acquire(blocking=False):
        thread = threading.Thread(target=look_up, name="webhook-host", daemon=True)
        thread.start()
        thread.join(LOOKED_UP_WITHIN_S)
    if problems:
        raise _invalid("The webhook's address", address, problems[0])


def resolve_address(host: str, port: int, *, inside_allowed: bool) -> SocketAddress:
    """Return where to connect to for a host; connecting to just that keeps a second answer of its DNS from counting.

    Raises:
        OSError: the host is not known, or one of its addresses is inside.
    """
    addresses = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)
    for *_, where in addresses:
        if not inside_allowed and not is_public(str(where[0])):
            raise PermissionError(f"{host} leads to {where[0]}, which is not an address of the public internet")
    family, _, _, _, where = addresses[0]
    return family, tuple(where)


def is_public(address: str) -> bool:
    """Return whether an address is one of the internet, and stands for no other one."""
    ip = ip_address(address.partition("%")[0])
    is_given_out = isinstance(ip, IPv4Address) or ip in _INTERNET_6
    return is_given_out and not any(ip in network for network in _NOT_PUBLIC if network.version == ip.version)


def _may_be_public(host: str) -> bool:
    """Return whether a host is a name, or an address of the internet."""
    with suppress(ValueError):
        return is_public(host)
    return True


def _invalid(what: str, address: str, problem: str) -> ServiceError:
    return ServiceError(ProblemCode.INVALID_REQUEST, f"{what} {address!r:.100} cannot be used: {problem}.")


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
    check_address(address, inside_allowed=inside_allowed)
    teams.lock(session, team)
    if (session.scalar(select(func.count()).where(Webhook.team_id == team.id)) or 0) >= MAX_WEBHOOKS:
        raise ServiceError(
            ProblemCode.INVALID_REQUEST, f"{team.name} has {MAX_WEBHOOKS} webhooks, no more are possible."
        )
    made = Webhook(team_id=team.id, address=address, secret=secrets.token_hex(32))
    session.add(made)
    session.flush()
    record(session, by, "webhook.add", f"team:{team.id}", {"webhook": str(made.id), "address": address})
    return NewWebhookView.from_row(made)


def remove(session: Session, by: Principal, team: Team, webhook_id: UUID) -> None:
    """Send no further notices to a webhook.

    Raises:
        ServiceError: not the captain, or the team has no such webhook.
    """
    by.require_leader(team.id)
    webhook = session.get(Webhook, webhook_id)
    if webhook is None or webhook.team_id != team.id:
        raise not_found("webhook", webhook_id)
    before = {"webhook": str(webhook.id), "address": webhook.address}
    session.execute(delete(Notice).where(Notice.target == str(webhook.id), Notice.sent_at.is_(None)))
    session.delete(webhook)
    record(session, by, "webhook.remove", f"team:{team.id}", {"webhook": None}, before=before)


def list_webhooks(session: Session, by: Principal, team: Team) -> list[WebhookView]:
    """Return the webhooks of a team, without their secrets.

    Raises:
        ServiceError: not the captain.
    """
    by.require_leader(team.id)
    webhooks = session.scalars(
        select(Webhook).where(Webhook.team_id == team.id).order_by(Webhook.created_at, Webhook.id)
    )
    return [WebhookView.model_validate(one, from_attributes=True) for one in webhooks]


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
        parts = check_address(address, inside_allowed=inside_allowed)
        status = _post(parts, body, headers, inside_allowed=inside_allowed)
    except (OSError, http.client.HTTPException, ServiceError, UnicodeError) as error:
        raise Undelivered(f"{type(error).__name__}: {error}") from error
    if not 200 <= status < 300:
        raise Undelivered(f"It answered with status {status}, expected 2xx.")


def _post(parts: SplitResult, body: bytes, headers: dict[str, str], *, inside_allowed: bool) -> int:
    host, secure = parts.hostname or "", parts.scheme == "https"
    port = parts.port or (443 if secure else 80)
    family, where = resolve_address(host, port, inside_allowed=inside_allowed)
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
