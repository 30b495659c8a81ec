"""What the protocol tus 1.0.0 asks of every request and answer, and its header formats (https://tus.io/protocols).

Core, with the extensions creation, termination, expiration and checksum.
"""

import base64
import binascii
import hashlib
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from email.utils import format_datetime
from types import MappingProxyType
from typing import Any, Final

from starlette.datastructures import MutableHeaders
from starlette.requests import Request
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from ...errors import ProblemCode, ServiceError
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
