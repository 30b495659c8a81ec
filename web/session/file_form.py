"""Reads a form with a file as it arrives: its fields first, then the file's bytes, never more than a piece of them.

Called by the upload page.
"""

import asyncio
from collections import deque
from collections.abc import AsyncIterator
from contextlib import suppress
from dataclasses import dataclass, field

from python_multipart.exceptions import FormParserError
from python_multipart.multipart import MultipartParser, parse_options_header
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect, Request

from .signer import require_same_site

MEDIA_TYPE = "multipart/form-data"
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
    if media_type.decode("latin-1") != MEDIA_TYPE or not boundary:
        shown = media_type.decode("latin-1")[:80]
        raise HTTPException(415, f"Expected a form as {MEDIA_TYPE}, got {shown or 'no content type'}.")
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
