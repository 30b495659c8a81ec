"""Opens a log, plain or gzipped, and reads at most a given number of bytes from it."""

import gzip
import io
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from enum import StrEnum
from pathlib import Path
from typing import Any, BinaryIO, cast

from vitac.errors import VitacError

GZIP_MAGIC = b"\x1f\x8b"
MAX_UNPACKED_BYTES = 1 << 28
"""Largest log that is accepted, uncompressed [bytes]; a whole one of ours has about 2,000,000."""


class UnpackProblem(StrEnum):
    """Why a gzipped log cannot be read; stable codes for the API."""

    DAMAGED = "damaged"
    """The gzip data is truncated or corrupt."""
    TOO_LARGE = "too_large"
    """Uncompressed it is larger than the limit."""


class UnpackFailed(VitacError):
    """A gzipped log cannot be read: compress it again, or give it uncompressed."""

    def __init__(self, problem: UnpackProblem, message: str) -> None:
        super().__init__(message)
        self.problem = problem


@contextmanager
def open_log(path: Path, max_bytes: int = MAX_UNPACKED_BYTES) -> Iterator[io.BufferedReader]:
    """Open a log as a stream of its uncompressed bytes, whatever the file's name.

    Reading raises `UnpackFailed` where the gzip data is corrupt or the log is larger than `max_bytes`.
    """
    with path.open("rb") as file:
        packed = file.read(len(GZIP_MAGIC)) == GZIP_MAGIC
        file.seek(0)
        source = cast(BinaryIO, gzip.GzipFile(fileobj=file)) if packed else file
        yield io.BufferedReader(_Bounded(source, max_bytes))


class _Bounded(io.RawIOBase):
    """Reads another stream up to a number of bytes."""

    def __init__(self, source: BinaryIO, max_bytes: int) -> None:
        self._source = source
        self._remaining = self._max_bytes = max_bytes

    def readable(self) -> bool:
        """Return True: the stream can be read."""
        return True

    def readinto(self, buffer: Any) -> int:
        """Fill the buffer or a part of it, and return the number of bytes read."""
        try:
            data = self._source.read(len(buffer))
        except (EOFError, zlib.error, gzip.BadGzipFile) as error:
            message = f"The gzip data is truncated or corrupt: {error}. Compress the log again."
            raise UnpackFailed(UnpackProblem.DAMAGED, message) from error
        self._remaining -= len(data)
        if self._remaining < 0:
            raise UnpackFailed(
                UnpackProblem.TOO_LARGE, f"Expected at most {self._max_bytes} bytes of uncompressed log, got more."
            )
        buffer[: len(data)] = data
        return len(data)
