"""One piece of an upload while it arrives, in the event loop: what has come is stored, and counts once it is stored."""

import asyncio
import hashlib
from collections.abc import AsyncIterator, Callable, Mapping
from dataclasses import dataclass, field
from datetime import datetime
from types import MappingProxyType
from typing import Any
from uuid import UUID

from starlette.requests import ClientDisconnect

from ..errors import ProblemCode, ServiceError
from ..services import Services
from . import intake, partial_uploads
from .partial_uploads import StoredPart

CHECKSUMS: Mapping[str, Callable[[], Any]] = MappingProxyType(
    {"sha256": hashlib.sha256, "sha1": lambda: hashlib.sha1(usedforsecurity=False)}
)
"""The protocol tus obliges servers to know sha1; it finds damage on the way, nothing else."""


@dataclass(frozen=True, kw_only=True)
class Checksum:
    """Digest of a piece as the client gives it."""

    algorithm: str
    digest: bytes


PART_BYTES = 4 << 20
"""So much of a piece is held in memory."""


@dataclass(kw_only=True)
class PieceReceiver:
    """One piece while it arrives.

    Attributes:
        services: of this process.
        upload_id: the upload that it belongs to.
        offset: first byte of what has not been stored yet.
        end: length of the whole upload, or the largest that it may have.
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
            await asyncio.to_thread(self._drop)
            raise ServiceError(ProblemCode.CHECKSUM_MISMATCH, "The piece was damaged on its way. Send it again.")
        await self._store()
        await asyncio.to_thread(self._count)

    async def _take(self, chunk: bytes) -> None:
        if self.offset + self._waiting_bytes + len(chunk) > self.end:
            raise intake.too_large(self.end, "more were sent")
        self._chunks.append(chunk)
        self._waiting_bytes += len(chunk)
        if self._waiting_bytes >= PART_BYTES:
            await self._store()
            if self.checksum is None:
                await asyncio.to_thread(self._count)

    async def _store(self) -> None:
        if not self._chunks:
            return
        content = b"".join(self._chunks)
        self._chunks.clear()
        self._waiting_bytes = 0
        part = await asyncio.to_thread(partial_uploads.store_part, self.services, self.upload_id, self.offset, content)
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
            await asyncio.to_thread(self._count)
        else:
            await asyncio.to_thread(self._drop)

    def _drop(self) -> None:
        for part in self._uncounted:
            self.services.blobs.delete_part(part.key)
        self._uncounted.clear()
