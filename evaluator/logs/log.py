"""Logs of episodes: written and read, plain or gzipped, a line for each record."""

import gzip
import hashlib
import io
import json
import zlib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from enum import StrEnum
from itertools import islice
from pathlib import Path
from typing import Any, BinaryIO, Literal, TypeVar, cast

from pydantic import NonNegativeInt, ValidationError, field_validator
from vitac.errors import VitacError

from ..episodes.records import NOT_HASHED, EpisodeRecord, Manifest, canonical_json
from ..strict_model import StrictModel, Word, explain

FORMAT_VERSION = 1
MAX_LINE_BYTES = 1 << 20
"""Longest line that is accepted [bytes]; 50 env steps take about 75,000, a failed policy's output up to 390,000."""
MAX_INFO_BYTES = 6 << 10
"""Largest info of an env step that is accepted, as JSON [bytes]; the tasks' own infos have up to 1,418."""
MAX_INFO_VALUES = 500
"""Largest number of values in an info, lists and objects included; the tasks' own infos have up to 115.

Reading time grows with the number of values rather than of bytes: without this limit the worst log of 32 MiB takes a
minute to read, and each shard reads it twice.
"""


_TEAM_CHARACTERS = 200


LineT = TypeVar("LineT", bound=StrictModel)


class LogProblem(StrEnum):
    """Why a log is refused; stable codes for the API."""

    NOT_A_LOG = "not_a_log"
    """The first line is not the header of an evaluation log."""
    UNKNOWN_VERSION = "unknown_version"
    """The format is of another version."""
    LINE_TOO_LONG = "line_too_long"
    """A line is longer than the limit."""
    INFO_TOO_LARGE = "info_too_large"
    """The info of an env step is larger than the limit."""
    NOT_JSON = "not_json"
    """A line is not one JSON object of finite numbers."""
    INVALID = "invalid"
    """A line lacks a key, has an unknown one, or a wrong value."""
    ALTERED = "altered"
    """A line, or one before it, was changed, moved, duplicated or removed."""
    EPISODE_REPEATED = "episode_repeated"
    """An episode is in the log twice."""
    TRUNCATED = "truncated"
    """The last line is missing."""
    TRAILING = "trailing"
    """There is data after the last line."""


class LogRejected(VitacError):
    """A log cannot be read as one evaluation; correct it or make it again.

    Attributes:
        problem: stable code.
        line: number of the line, from 1.
    """

    def __init__(self, problem: LogProblem, line: int, message: str) -> None:
        super().__init__(f"Line {line}: {message}")
        self.problem = problem
        self.line = line


def is_team_name(text: str) -> bool:
    """Return whether a log's header can name this team."""
    return len(text) <= _TEAM_CHARACTERS and text.isprintable()


class LogHeader(StrictModel):
    """The first line: provenance of the evaluation, its team and its submission."""

    format: Literal["vitac-log"] = "vitac-log"
    version: Literal[1] = 1
    team: str | None = None
    submission_digest: Word | None = None
    manifest: Manifest

    @field_validator("team")
    @classmethod
    def _is_name(cls, team: str | None) -> str | None:
        if team is not None and not is_team_name(team):
            raise ValueError(f"must be one line of at most {_TEAM_CHARACTERS} printable characters")
        return team


class _EpisodeLine(StrictModel):
    record: EpisodeRecord


class _EndLine(StrictModel):
    episodes: NonNegativeInt


def write_log(stream: BinaryIO, header: LogHeader, records: Iterable[EpisodeRecord]) -> None:
    """Write a whole log, without timings and output of its records; the same evaluation gives the same bytes.

    Args:
        stream: where the log is written.
        header: its first line.
        records: one for each episode, in the order of their numbers.
    """
    digest = _write_line(stream, "", header.model_dump(mode="json"))
    episodes = 0
    for record in records:
        digest = _write_line(stream, digest, {"record": record.model_dump(mode="json", exclude=set(NOT_HASHED))})
        episodes += 1
    _write_line(stream, digest, {"episodes": episodes})


def is_log(path: Path) -> bool:
    """Return whether a file starts like one of our logs, gzipped or not."""
    with open_log(path) as stream:
        return b'"vitac-log"' in stream.readline(MAX_LINE_BYTES)


class LogReader:
    """Reads a log line by line; memory does not grow with its size.

    Args:
        stream: the log, opened for reading bytes.

    Raises:
        LogRejected: raised here for the header, by `records` for the rest.
    """

    def __init__(self, stream: BinaryIO) -> None:
        self._stream = stream
        self._line = 0
        self._digest = ""
        self.header = self._header(self._next_line())

    @property
    def line(self) -> int:
        """Number of the line that was read last."""
        return self._line

    @property
    def digest(self) -> str:
        """SHA-256 [hex] of the log up to the line that was read last; after `records`, of the whole log."""
        return self._digest

    def records(self) -> Iterator[EpisodeRecord]:
        """Yield the records in order; only after the last one is the log known to be whole and unaltered."""
        seen: set[int] = set()
        last = 0
        while True:
            text = self._next_line()
            if not text.endswith(b"\n"):
                raise self._rejected(LogProblem.TRUNCATED, "the log has no last line; it is truncated.")
            content = self._object(text)
            if "episodes" in content:
                self._check_end(self._checked(_EndLine, content), len(seen))
                return
            self._require_small_infos(content.get("record"))
            record = self._checked(_EpisodeLine, content).record
            if record.episode in seen:
                raise self._rejected(LogProblem.EPISODE_REPEATED, f"episode {record.episode} is in the log twice.")
            if record.episode < last:
                raise self._rejected(
                    LogProblem.ALTERED, f"expected episodes in ascending order, got {record.episode} after {last}."
                )
            seen.add(record.episode)
            last = record.episode
            yield record

    def _header(self, text: bytes) -> LogHeader:
        content = self._object(text, LogProblem.NOT_A_LOG)
        if content.get("format") != "vitac-log":
            raise self._rejected(LogProblem.NOT_A_LOG, 'expected the header of a log, {"format": "vitac-log", ...}.')
        if content.get("version") != FORMAT_VERSION:
            got = content.get("version")
            raise self._rejected(
                LogProblem.UNKNOWN_VERSION, f"expected format version {FORMAT_VERSION}, got {got!r:.40}."
            )
        return self._checked(LogHeader, content)

    def _check_end(self, end: _EndLine, episodes: int) -> None:
        if end.episodes != episodes:
            raise self._rejected(
                LogProblem.ALTERED, f"expected {end.episodes} episodes, as the last line says, got {episodes}."
            )
        if self._stream.read(1):
            self._line += 1
            raise self._rejected(
                LogProblem.TRAILING, "there is data after the end of the log; upload one log at a time."
            )

    def _next_line(self) -> bytes:
        self._line += 1
        text = self._stream.readline(MAX_LINE_BYTES + 1)
        if len(text) > MAX_LINE_BYTES:
            raise self._rejected(LogProblem.LINE_TOO_LONG, f"expected at most {MAX_LINE_BYTES} bytes, got more.")
        return text

    def _object(self, text: bytes, problem: LogProblem = LogProblem.NOT_JSON) -> dict[str, Any]:
        try:
            content = json.loads(text.decode("utf-8"), parse_constant=_refuse_constant, object_pairs_hook=_unique)
        except (ValueError, RecursionError) as error:
            raise self._rejected(problem, f"it is not JSON: {error!s:.120}.") from error
        if not isinstance(content, dict):
            raise self._rejected(problem, f"expected a JSON object, got a {type(content).__name__}.")
        return content

    def _checked(self, model: type[LineT], content: dict[str, Any]) -> LineT:
        claimed = content.pop("digest", None)
        try:
            line = model.model_validate(content)
        except ValidationError as error:
            raise self._rejected(LogProblem.INVALID, explain(model, error)) from error
        self._digest = _line_digest(self._digest, content)
        if claimed != self._digest:
            raise self._rejected(LogProblem.ALTERED, "its digest is wrong: the line was altered, moved or duplicated.")
        return line

    def _require_small_infos(self, record: object) -> None:
        """Refuse oversized infos before any is validated; wrong types are refused by the validation that follows."""
        infos = record.get("infos") if isinstance(record, dict) else None
        for env_step, info in enumerate(infos if isinstance(infos, list) else [], start=1):
            place = f"the info of env step {env_step}"
            values = count_values(info, MAX_INFO_VALUES)
            if values > MAX_INFO_VALUES:
                message = f"{place}: expected at most {MAX_INFO_VALUES} values, got more."
                raise self._rejected(LogProblem.INFO_TOO_LARGE, message)
            n_bytes = len(json.dumps(info, separators=(",", ":")))
            if n_bytes > MAX_INFO_BYTES:
                message = f"{place}: expected at most {MAX_INFO_BYTES} bytes of JSON, got {n_bytes}."
                raise self._rejected(LogProblem.INFO_TOO_LARGE, message)

    def _rejected(self, problem: LogProblem, message: str) -> LogRejected:
        return LogRejected(problem, self._line, message)


def _write_line(stream: BinaryIO, previous: str, content: dict[str, Any]) -> str:
    digest = _line_digest(previous, content)
    stream.write(canonical_json({**content, "digest": digest}) + b"\n")
    return digest


def _line_digest(previous: str, content: dict[str, Any]) -> str:
    return hashlib.sha256(previous.encode("ascii") + canonical_json(content)).hexdigest()


def count_values(content: object, limit: int) -> int:
    """Return the number of values in JSON content, lists and objects included; stop counting soon after `limit`."""
    pending, values = [content], 0
    while pending and values <= limit:
        value = pending.pop()
        values += 1
        if isinstance(value, dict | list):
            pending.extend(islice(value.values() if isinstance(value, dict) else value, limit))
    return values


def _refuse_constant(name: str) -> None:
    raise ValueError(f"{name} is not a number")


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    content = dict(pairs)
    if len(content) != len(pairs):
        raise ValueError("a key is repeated")
    return content


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
