"""Opens a log as it is or packed with gzip, and never gives more bytes than a limit."""

import gzip
import io
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from enum import StrEnum
from pathlib import Path
from typing import Any, BinaryIO, cast

from vitac.envs.errors import VitacError

GZIP_MAGIC = b"\x1f\x8b"
MAX_UNPACKED_BYTES = 1 << 28
"""Largest log that is read, unpacked [bytes]; a whole one of ours has about 2,000,000."""


class UnpackProblem(StrEnum):
    """Why a packed log cannot be read; stable codes for the API."""

    DAMAGED = "damaged"
    """It is not whole gzip."""
    TOO_LARGE = "too_large"
    """Unpacked it is larger than is read."""


class UnpackFailed(VitacError):
    """A packed log cannot be read: pack it again, or give it unpacked."""

    def __init__(self, problem: UnpackProblem, message: str) -> None:
        super().__init__(message)
        self.problem = problem


@contextmanager
def open_log(path: Path, most_bytes: int = MAX_UNPACKED_BYTES) -> Iterator[io.BufferedReader]:
    """Return a log's unpacked bytes as a stream, whatever its name.

    Reading raises `UnpackFailed` where the file is damaged or unpacks to more than `most_bytes`.
    """
    with path.open("rb") as file:
        packed = file.read(len(GZIP_MAGIC)) == GZIP_MAGIC
        file.seek(0)
        source = cast(BinaryIO, gzip.GzipFile(fileobj=file)) if packed else file
        yield io.BufferedReader(_Bounded(source, most_bytes))


class _Bounded(io.RawIOBase):
    """Reads another stream up to a number of bytes."""

    def __init__(self, source: BinaryIO, most_bytes: int) -> None:
        self._source = source
        self._left = self._most = most_bytes

    def readable(self) -> bool:
        """Return True, as the stream can be read."""
        return True

    def readinto(self, buffer: Any) -> int:
        """Fill the buffer, or a part of it."""
        try:
            data = self._source.read(len(buffer))
        except (EOFError, zlib.error, gzip.BadGzipFile) as error:
            raise UnpackFailed(UnpackProblem.DAMAGED, f"The file is not whole gzip: {error}. Pack it again.") from error
        self._left -= len(data)
        if self._left < 0:
            raise UnpackFailed(
                UnpackProblem.TOO_LARGE, f"A log may have at most {self._most} bytes, unpacked; more came."
            )
        buffer[: len(data)] = data
        return len(data)
