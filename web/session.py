"""The browser's session: its signed cookie, and the forms with files that belong to it."""

import asyncio
import hmac
import os
import secrets
from collections import deque
from collections.abc import AsyncIterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from hashlib import sha256
from pathlib import Path
from urllib.parse import parse_qsl
from uuid import UUID

from python_multipart.exceptions import FormParserError
from python_multipart.multipart import MultipartParser, parse_options_header
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect, Request

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


FILE_MEDIA_TYPE = "multipart/form-data"
FIELDS_TIMEOUT_S = 30.0
"""Time in which the fields before the file must arrive."""
MAX_PARTS = 16
FORM_LIMIT_BYTES = 1 << 16
"""Maximum length of a field before the file."""
DISCARDED_BYTES = 64 << 20
DISCARD_TIMEOUT_S = 60.0


@dataclass(kw_only=True)
class FileForm:
    """A form up to its file.

    Attributes:
        fields: those that stand before the file.
        file_name: as the browser names it; empty where no file was chosen.
        pieces: the file's bytes, as they arrive.
    """

    fields: dict[str, str]
    file_name: str
    pieces: AsyncIterator[bytes]

    async def discard(self) -> None:
        """Read the rest, but not too much: a browser looks at the answer only when it has sent everything."""
        left = DISCARDED_BYTES
        with suppress(HTTPException, ClientDisconnect, TimeoutError):
            async with asyncio.timeout(DISCARD_TIMEOUT_S):
                async for piece in self.pieces:
                    left -= len(piece)
                    if left < 0:
                        return


async def read_file_form(request: Request) -> FileForm:
    """Read a form sent by one of our own pages up to the first byte of its file; what follows the file is not read.

    Raises:
        HTTPException: 403 if another site sent it, 400, 408, 413 or 415 if it is no such form.
    """
    require_same_site(request)
    media_type, options = parse_options_header(request.headers.get("content-type", ""))
    boundary = options.get(b"boundary")
    if media_type.decode("latin-1") != FILE_MEDIA_TYPE or not boundary:
        shown = media_type.decode("latin-1")[:80]
        raise HTTPException(415, f"Expected a form as {FILE_MEDIA_TYPE}, got {shown or 'no content type'}.")
    arriving = _Arriving(boundary)
    body = request.stream()
    try:
        async with asyncio.timeout(FIELDS_TIMEOUT_S):
            async for chunk in body:
                arriving.add(chunk)
                if arriving.file_name is not None:
                    break
    except TimeoutError:
        raise HTTPException(
            408, f"The form's fields did not arrive within {FIELDS_TIMEOUT_S:g} s.", {"Connection": "close"}
        ) from None
    except ClientDisconnect as error:
        raise HTTPException(400, "The connection was closed before the form's file arrived.") from error
    return FileForm(fields=arriving.fields, file_name=arriving.file_name or "", pieces=_pieces(arriving, body))


async def _pieces(arriving: "_Arriving", body: AsyncIterator[bytes]) -> AsyncIterator[bytes]:
    while True:
        while arriving.pieces:
            yield arriving.pieces.popleft()
        if arriving.is_complete:
            return
        try:
            arriving.add(await anext(body))
        except StopAsyncIteration:
            raise HTTPException(400, "The form ended before its file did. Send it again.") from None


@dataclass
class _Arriving:
    """The parts of a form, filled by the parser's callbacks while chunks are added."""

    boundary: bytes
    fields: dict[str, str] = field(default_factory=dict)
    file_name: str | None = None
    pieces: deque[bytes] = field(default_factory=deque)
    is_complete: bool = False
    _parts: int = 0
    _headers: dict[bytes, bytes] = field(default_factory=dict)
    _header: tuple[bytearray, bytearray] = field(default_factory=lambda: (bytearray(), bytearray()))
    _name: str = ""
    _value: bytearray = field(default_factory=bytearray)
    _in_file: bool = False

    def __post_init__(self) -> None:
        try:
            self._parser = MultipartParser(
                self.boundary,
                {
                    "on_part_begin": self._begin_part,
                    "on_header_field": lambda data, start, end: self._header[0].extend(data[start:end]),
                    "on_header_value": lambda data, start, end: self._header[1].extend(data[start:end]),
                    "on_header_end": self._end_header,
                    "on_headers_finished": self._begin_content,
                    "on_part_data": self._add_content,
                    "on_part_end": self._end_part,
                    "on_end": self._end,
                },
            )
        except FormParserError as error:
            raise _malformed(error) from error

    def add(self, chunk: bytes) -> None:
        """Parse a chunk.

        Raises:
            HTTPException: the form is malformed, or its fields are too long.
        """
        try:
            self._parser.write(chunk)
        except FormParserError as error:
            raise _malformed(error) from error

    def _begin_part(self) -> None:
        self._parts += 1
        if self._parts > MAX_PARTS:
            raise HTTPException(413, f"Expected a form of at most {MAX_PARTS} fields, got more.")
        self._headers, self._name, self._value = {}, "", bytearray()

    def _end_header(self) -> None:
        name, value = self._header
        self._headers[bytes(name).lower()] = bytes(value)
        self._header = (bytearray(), bytearray())

    def _begin_content(self) -> None:
        _, options = parse_options_header(self._headers.get(b"content-disposition", b""))
        self._name = options.get(b"name", b"").decode("utf-8", "replace")
        self._in_file = b"filename" in options and self.file_name is None
        if self._in_file:
            self.file_name = options[b"filename"].decode("utf-8", "replace")

    def _add_content(self, data: bytes, start: int, end: int) -> None:
        if self._in_file:
            self.pieces.append(data[start:end])
        elif self.file_name is None:
            self._value += data[start:end]
            if len(self._value) > FORM_LIMIT_BYTES:
                raise HTTPException(413, f"Expected fields of at most {FORM_LIMIT_BYTES} bytes, got more.")

    def _end_part(self) -> None:
        if self._in_file:
            self._in_file, self.is_complete = False, True
        elif self.file_name is None:
            if b"\0" in self._value:
                raise HTTPException(400, "Expected text in the form's fields, got a NUL character.")
            self.fields[self._name] = self._value.decode("utf-8", "replace")

    def _end(self) -> None:
        self.is_complete = True


def _malformed(error: FormParserError) -> HTTPException:
    return HTTPException(400, f"The form is malformed: {str(error)[:200]}. Send it again.")
