"""The browser's signed session: which API token signed in, and until when. Called by the pages.

The cookie holds the token's row id and an expiry, signed; never the token. The row is looked up at each request, so a
revoked or expired token ends its sessions at once.
"""

import hmac
import os
import secrets
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from hashlib import sha256
from pathlib import Path
from urllib.parse import parse_qsl
from uuid import UUID

from starlette.exceptions import HTTPException
from starlette.requests import Request

COOKIE = "vitac_session"
LIFETIME = timedelta(hours=12)
DEVICE_COOKIE = "vitac_device"
DEVICE_LIFETIME = timedelta(days=180)
KEY_BYTES = 32


@dataclass(frozen=True, kw_only=True)
class BrowserSession:
    """A signed-in browser.

    Attributes:
        token_id: row id of the API token that signed in.
        expires_at: when the session ends, aware UTC.
    """

    token_id: UUID
    expires_at: datetime

    @property
    def began_at(self) -> datetime:
        """When somebody signed in."""
        return self.expires_at - LIFETIME


@dataclass(frozen=True, kw_only=True)
class SessionSigner:
    """Signs and reads session cookies and the form tokens bound to them, with one secret key."""

    key: bytes

    def sign(self, session: BrowserSession) -> str:
        """Return the cookie's value for a session."""
        payload = f"{session.token_id}.{int(session.expires_at.timestamp())}"
        return f"{payload}.{self._mac('session', payload)}"

    def read(self, cookie: str | None, *, now: datetime) -> BrowserSession | None:
        """Return the session of a cookie, or None if it is missing, altered or expired."""
        if cookie is None:
            return None
        payload, _, mac = cookie.rpartition(".")
        token_id, _, expiry = payload.rpartition(".")
        if not token_id or not hmac.compare_digest(mac.encode(), self._mac("session", payload).encode()):
            return None
        expires_at = datetime.fromtimestamp(int(expiry), UTC)
        return BrowserSession(token_id=UUID(token_id), expires_at=expires_at) if now < expires_at else None

    def sign_device(self, member: str, *, now: datetime) -> str:
        """Return the cookie's value for a browser on which a member has signed in."""
        payload = f"{secrets.token_hex(8)}.{int((now + DEVICE_LIFETIME).timestamp())}"
        return f"{payload}.{self._mac('device', f'{payload}.{member}')}"

    def read_device(self, cookie: str | None, member: str, *, now: datetime) -> str | None:
        """Return which device this is, or None if that member has not signed in on it, or long ago."""
        payload, _, mac = (cookie or "").rpartition(".")
        if not payload or not hmac.compare_digest(mac.encode(), self._mac("device", f"{payload}.{member}").encode()):
            return None
        device, _, expiry = payload.partition(".")
        return device if now.timestamp() < int(expiry) else None

    def form_token(self, cookie: str) -> str:
        """Return the value that a form must send back: it proves that a page of this session sent the form."""
        return self._mac("form", cookie)

    def accepts_form_token(self, cookie: str | None, token: str) -> bool:
        """Return whether `token` was made for this session."""
        return cookie is not None and hmac.compare_digest(token.encode(), self.form_token(cookie).encode())

    def _mac(self, purpose: str, text: str) -> str:
        return hmac.new(self.key, f"{purpose}:{text}".encode(), sha256).hexdigest()


def begin(token_id: UUID, *, now: datetime) -> BrowserSession:
    """Start a session of `LIFETIME` for a token."""
    return BrowserSession(token_id=token_id, expires_at=now + LIFETIME)


def load_key(path: Path) -> bytes:
    """Return the signing key stored in `path`, created (mode 0600) on first use; servers started at once share one."""
    path.parent.mkdir(parents=True, exist_ok=True)
    draft = path.with_name(f"{path.name}.{secrets.token_hex(8)}")
    if not path.exists():
        descriptor = os.open(draft, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
        with os.fdopen(descriptor, "wb") as file:
            file.write(secrets.token_bytes(KEY_BYTES))
        try:
            os.link(draft, path)
        except FileExistsError:
            pass
        finally:
            draft.unlink()
    return path.read_bytes()


MEDIA_TYPE = "application/x-www-form-urlencoded"


async def read_form(request: Request) -> Mapping[str, str]:
    """Return the fields of a form sent by one of our own pages; of equal names the last one counts.

    Raises:
        HTTPException: 403 if another site sent it, 415 if it is not a form.
    """
    require_same_site(request)
    media_type = request.headers.get("content-type", "").partition(";")[0].strip().lower()
    if media_type != MEDIA_TYPE:
        raise HTTPException(415, f"Expected a form as {MEDIA_TYPE}, got {media_type or 'no content type'}.")
    body = await request.body()  # the application refuses one that is too large
    return dict(parse_qsl(body.decode("utf-8", errors="replace"), keep_blank_values=True))


def require_same_site(request: Request) -> None:
    """Refuse a POST from another site, by Fetch metadata or else the Origin header.

    Raises:
        HTTPException: 403.
    """
    site = request.headers.get("sec-fetch-site")
    origin = request.headers.get("origin")
    foreign_site = site is not None and site not in {"same-origin", "none"}
    host = request.headers.get("host")
    foreign_origin = site is None and origin is not None and origin.partition("://")[2] != host
    if foreign_site or foreign_origin:
        raise HTTPException(403, "This form was sent from another site. Open the page here and send it again.")


def local_target(target: str) -> str:
    """Return the path to go to after signing in: `target` if it is on this site, else the submissions."""
    # Browsers read a backslash as a slash and leave out tabs and line ends.
    is_local = target.startswith("/") and not target.startswith("//") and "\\" not in target
    return target if is_local and target.isprintable() else "/submissions"
