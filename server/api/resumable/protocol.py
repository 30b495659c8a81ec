"""What the protocol tus 1.0.0 asks of every request and answer, and its header formats (https://tus.io/protocols).

Core, with the extensions creation, termination, expiration and checksum.
"""

import asyncio
import base64
import binascii
import hashlib
import re
from collections.abc import AsyncIterator, Callable, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from email.utils import format_datetime
from types import MappingProxyType
from typing import Any, Final
from uuid import UUID

from fastapi.concurrency import run_in_threadpool
from starlette.datastructures import MutableHeaders
from starlette.requests import ClientDisconnect, Request
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from ...errors import ProblemCode, ServiceError
from ...services import Services
from ...submissions import intake, partial_uploads
from ...submissions.partial_uploads import StoredPart
from ..problems import problem

VERSION: Final = "1.0.0"
EXTENSIONS: Final = "creation,termination,expiration,checksum"
PIECE_TYPE: Final = "application/offset+octet-stream"
SHA256: Final = re.compile("[0-9a-f]{64}")
CHECKSUM_MISMATCH_STATUS: Final = 460
"""The protocol's own status, which no registry lists."""
CHECKSUMS: Mapping[str, Callable[[], Any]] = MappingProxyType(
    {"sha256": hashlib.sha256, "sha1": lambda: hashlib.sha1(usedforsecurity=False)}
)
"""The protocol obliges servers to know sha1; it finds damage on the way, nothing else."""


class ProtocolVersion:
    """ASGI middleware: below a path, requests name the version that we speak, and every answer does."""

    def __init__(self, app: ASGIApp, prefix: str) -> None:
        self._app = app
        self._prefix = prefix

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Hand the request on, or answer 412."""
        if scope["type"] != "http" or not f"{scope['path']}/".startswith(f"{self._prefix}/"):
            await self._app(scope, receive, send)
            return

        async def send_with_version(message: Message) -> None:
            if message["type"] == "http.response.start":
                MutableHeaders(scope=message)["Tus-Resumable"] = VERSION
            await send(message)

        named = Request(scope).headers.get("tus-resumable")
        if scope["method"] in {"OPTIONS", "GET"} or scope["path"].endswith("/submission") or named == VERSION:
            await self._app(scope, receive, send_with_version)
            return
        refusal = ServiceError(
            ProblemCode.WRONG_PROTOCOL_VERSION,
            f"Expected the header Tus-Resumable: {VERSION}, got {named or 'none'!r}.",
        )
        answer = problem(Request(scope), refusal, {"Tus-Version": VERSION, "Connection": "close"})
        await answer(scope, receive, send_with_version)


@dataclass(frozen=True, kw_only=True)
class Checksum:
    """Digest of a piece as the client gives it."""

    algorithm: str
    digest: bytes


def read_number(request: Request, name: str) -> int:
    """Return a header that holds a number of bytes.

    Raises:
        ServiceError: it is missing or no such number.
    """
    text = request.headers.get(name, "")
    if not (text.isascii() and text.isdigit() and len(text) < 19):
        raise ServiceError(ProblemCode.LENGTH_INVALID, f"Expected {name} in bytes, got {text[:40] or 'none'!r}.")
    return int(text)


def read_metadata(request: Request) -> dict[str, str]:
    """Return what Upload-Metadata says: names, each with a value in base64.

    Raises:
        ServiceError: it has another form.
    """
    found: dict[str, str] = {}
    for pair in filter(None, (part.strip() for part in request.headers.get("upload-metadata", "").split(","))):
        name, _, value = pair.partition(" ")
        try:
            text = base64.b64decode(value.strip(), validate=True).decode()
        except (binascii.Error, UnicodeDecodeError):
            text = "\0"
        if "\0" in text or name in found:
            raise ServiceError(
                ProblemCode.INVALID_REQUEST, f"Expected Upload-Metadata as `name base64,...`, got {pair!r:.80}."
            )
        found[name] = text
    return found


def read_checksum(request: Request) -> Checksum | None:
    """Return what Upload-Checksum says.

    Raises:
        ServiceError: unknown algorithm, or no base64.
    """
    given = request.headers.get("upload-checksum")
    if given is None:
        return None
    algorithm, _, value = given.partition(" ")
    try:
        digest = base64.b64decode(value.strip(), validate=True)
    except binascii.Error:
        digest = b""
    if algorithm not in CHECKSUMS or not digest:
        raise ServiceError(
            ProblemCode.INVALID_REQUEST,
            f"Expected Upload-Checksum as `{'|'.join(CHECKSUMS)} base64`, got {given!r:.80}.",
        )
    return Checksum(algorithm=algorithm, digest=digest)


def http_date(moment: datetime) -> str:
    """Return a time as HTTP headers have it."""
    return format_datetime(moment.astimezone(UTC), usegmt=True)


PART_BYTES = 4 << 20
"""So much of a piece is held in memory."""


@dataclass(kw_only=True)
class PieceReceiver:
    """One piece while it arrives.

    Attributes:
        services: of this process.
        upload_id: the upload that it belongs to.
        offset: first byte of what has not been stored yet.
        end: length of the whole upload.
        checksum: digest that the piece must have before any of it counts; None: each part counts once it is stored.
        expires_at: when the upload expires, after the last part that counts.
    """

    services: Services
    upload_id: UUID
    offset: int
    end: int
    checksum: Checksum | None
    expires_at: datetime
    _chunks: list[bytes] = field(default_factory=list, init=False)
    _waiting_bytes: int = field(default=0, init=False)
    _uncounted: list[StoredPart] = field(default_factory=list, init=False)

    async def receive(self, body: AsyncIterator[bytes]) -> None:
        """Store a piece; of one that is cut off or stays away, what has come so far.

        Raises:
            ServiceError: longer than the upload, damaged, idle for too long, cut off, or another client continued it.
        """
        digest = CHECKSUMS[self.checksum.algorithm]() if self.checksum else None
        try:
            async for chunk in intake.limit_idle_time(body, self.services.settings.upload_idle_timeout_s):
                if digest is not None:
                    digest.update(chunk)
                await self._take(chunk)
        except (ClientDisconnect, ServiceError, asyncio.CancelledError) as error:
            await self._end_early(error)
            if isinstance(error, ClientDisconnect):
                raise intake.truncated("the connection was closed") from error
            raise
        if self.checksum and digest is not None and digest.digest() != self.checksum.digest:
            await run_in_threadpool(self._drop)
            raise ServiceError(ProblemCode.CHECKSUM_MISMATCH, "The piece was damaged on its way. Send it again.")
        await self._store()
        await run_in_threadpool(self._count)

    async def _take(self, chunk: bytes) -> None:
        if self.offset + self._waiting_bytes + len(chunk) > self.end:
            raise ServiceError(
                ProblemCode.UPLOAD_TOO_LARGE, f"The upload was announced with {self.end} bytes; the piece has more."
            )
        self._chunks.append(chunk)
        self._waiting_bytes += len(chunk)
        if self._waiting_bytes >= PART_BYTES:
            await self._store()
            if self.checksum is None:
                await run_in_threadpool(self._count)

    async def _store(self) -> None:
        if not self._chunks:
            return
        content = b"".join(self._chunks)
        self._chunks.clear()
        self._waiting_bytes = 0
        part = await run_in_threadpool(partial_uploads.store_part, self.services, self.upload_id, self.offset, content)
        self._uncounted.append(part)
        self.offset += part.n_bytes

    def _count(self) -> None:
        if not self._uncounted:
            return
        try:
            with self.services.database.transaction() as session:
                self.expires_at = partial_uploads.add_parts(
                    session, self.services.settings, self.upload_id, self._uncounted
                )
        except ServiceError:
            self._drop()
            raise
        self._uncounted.clear()

    async def _end_early(self, error: BaseException) -> None:
        """Keep what has arrived of a piece that ends early; nothing of one that is wrong or has to be checked whole."""
        is_cut = not isinstance(error, ServiceError) or error.code is ProblemCode.UPLOAD_TRUNCATED
        if is_cut and self.checksum is None:
            await self._store()
            await run_in_threadpool(self._count)
        else:
            await run_in_threadpool(self._drop)

    def _drop(self) -> None:
        for part in self._uncounted:
            self.services.blobs.delete_part(part.key)
        self._uncounted.clear()
