"""Uploaded files under their SHA-256, in a local folder or a bucket; written once, never changed."""

import hashlib
import json
import secrets
import threading
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import Future
from contextlib import contextmanager
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from itertools import pairwise
from pathlib import Path
from typing import IO, TYPE_CHECKING

import obstore
from obstore.exceptions import BaseError, NotFoundError
from obstore.store import LocalStore, ObjectStore, from_url

from ..errors import ProblemCode, ServiceError, ServiceSettingsError, storage_full
from ..settings import Settings
from .scratch import is_disk_full

if TYPE_CHECKING:
    from obstore.store import RetryConfig

PART_BYTES = 8 << 20
PARTS_AT_ONCE = 2
"""A file is stored in parts; this number of them is in memory at a time."""
_COPY_BYTES = 1 << 20
PART_FOLDER = "partial"
"""Where the parts of uploads wait that are not complete; by upload."""
LIST_FOLDER = "pieces"
"""Lists of the pieces of files that are stored in pieces."""
_PIECE_BYTES = 64 << 10
"""Size from which a piece is a stored file of its own."""
PROBE_FOLDER = "probe"
RECENTLY = timedelta(hours=12)
"""A file that is stored again within this time is left as it is; housekeeping leaves files alone for longer."""


RETRIES: "RetryConfig" = {"max_retries": 5, "retry_timeout": timedelta(seconds=20)}
"""Retries of failed requests to a bucket; by default an upload would hang for three minutes."""


@dataclass(frozen=True, kw_only=True)
class Piece:
    """A part of a file; `sha256` is empty where it is too small for a stored file of its own."""

    start: int
    n_bytes: int
    sha256: str = ""


class StoredFileLost(ServiceError):
    """A stored file is gone or was altered: trying again does not help, restoring it from a backup does."""

    def __init__(self, detail: str) -> None:
        super().__init__(ProblemCode.STORAGE_UNAVAILABLE, detail)


def _open(url: str) -> ObjectStore:
    try:
        return from_url(url, retry_config=RETRIES)
    except (BaseError, ValueError) as error:
        reason = str(error).splitlines()[0]
        raise ServiceSettingsError(
            f"VITAC_STORAGE_URL is {url!r}: expected s3://bucket/prefix or file:///folder of a folder that exists, "
            f"got {reason!r}. Correct it, or create the folder."
        ) from error


class BlobStore:
    """Content-addressed files. Keys are `sha256/ab/abcd...`.

    Of a file that is stored in pieces `pieces/ab/abcd...` has the list, in order: what is large is a stored file
    itself, which other files may share, and what is small stands in the list.
    """

    def __init__(self, store: ObjectStore) -> None:
        self._store = store
        self._lock = threading.Lock()
        self._checking: Future[None] | None = None

    @classmethod
    def from_settings(cls, settings: Settings) -> "BlobStore":
        """Return the store that the settings name; by default the folder `blobs` of the state directory.

        Raises:
            ServiceSettingsError: the address names no store, or a folder that does not exist.
        """
        if settings.storage_url is not None:
            return cls(_open(settings.storage_url))
        folder = settings.state_dir / "blobs"
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        return cls(LocalStore(folder))

    def put(self, path: Path, sha256: str) -> None:
        """Store a file under its digest; one that was stored recently is not written again.

        One that has been there for long is stored again, so that whoever removes old files takes it for a new one.

        Raises:
            ServiceError: the store cannot be written.
        """
        with _working(), path.open("rb") as file:
            self._put(sha256, file)

    def put_in_pieces(self, path: Path, sha256: str, pieces: Sequence[Piece]) -> None:
        """Store a file under its digest, each of its large pieces once, whatever file that is of.

        Args:
            path: the file.
            sha256: its digest.
            pieces: all of it in order, from `cut`.

        Raises:
            ServiceError: the store cannot be written.
        """
        with _working():
            for piece in pieces:
                if piece.sha256:
                    self._put(piece.sha256, _read_piece(path, piece))
            listed = [
                {"sha256": piece.sha256} if piece.sha256 else {"data": b"".join(_read_piece(path, piece)).hex()}
                for piece in pieces
            ]
            obstore.put(self._store, _list_key(sha256), json.dumps(listed).encode())

    def _put(self, sha256: str, content: IO[bytes] | Iterator[bytes]) -> None:
        stored_at = self._find_time(make_key(sha256))
        if stored_at is None or stored_at <= datetime.now(UTC) - RECENTLY:
            obstore.put(self._store, make_key(sha256), content, chunk_size=PART_BYTES, max_concurrency=PARTS_AT_ONCE)

    def list_pieces(self, sha256: str) -> list[str]:
        """Return the digests of the stored files that a file consists of; none of one that is stored whole.

        Raises:
            ServiceError: the store cannot be read.
        """
        with _working():
            return [piece["sha256"] for piece in self._read_list(sha256) if "sha256" in piece]

    def list_used_pieces(self) -> set[str]:
        """Return the digests of the stored files that any file consists of.

        Raises:
            ServiceError: the store cannot be read.
        """
        with _working():
            listed = [meta["path"] for batch in obstore.list(self._store, prefix=LIST_FOLDER) for meta in batch]
        return {piece for path in listed for piece in self.list_pieces(path.rsplit("/", 1)[-1])}

    def _read_list(self, sha256: str) -> list[dict[str, str]]:
        try:
            listed: list[dict[str, str]] = json.loads(bytes(obstore.get(self._store, _list_key(sha256)).bytes()))
        except (NotFoundError, FileNotFoundError):
            return []
        return listed

    def fetch(self, sha256: str, destination: Path) -> None:
        """Write a stored file to a local path and check its digest on the way.

        Raises:
            StoredFileLost: it is not there or was altered.
            ServiceError: the store cannot be read.
        """
        with _working(), destination.open("xb") as file:
            for chunk in self.chunks(sha256):
                file.write(chunk)

    def read(self, sha256: str) -> bytes:
        """Return the content of a small stored file.

        Raises:
            StoredFileLost: it is not there or was altered.
            ServiceError: the store cannot be read.
        """
        return b"".join(self.chunks(sha256))

    def chunks(self, sha256: str) -> Iterator[bytes]:
        """Yield a stored file in pieces; only after the last one is its digest known to be right."""
        digest = hashlib.sha256()
        with _working():
            try:
                for chunk in self._read_chunks(sha256):
                    digest.update(chunk)
                    yield chunk
            except (NotFoundError, FileNotFoundError) as error:
                raise StoredFileLost(f"The stored file {sha256} is gone.") from error
        if digest.hexdigest() != sha256:
            raise StoredFileLost(f"The stored file {sha256} was altered in the store.")

    def _read_chunks(self, sha256: str) -> Iterator[bytes]:
        for piece in self._read_list(sha256) or [{"sha256": sha256}]:
            if "data" in piece:
                yield bytes.fromhex(piece["data"])
            else:
                yield from obstore.get(self._store, make_key(piece["sha256"])).stream(min_chunk_size=_COPY_BYTES)

    def holds(self, sha256: str) -> bool:
        """Return whether a file of that digest is stored."""
        return self._find_stored_time(sha256) is not None

    def is_older_than(self, sha256: str, age: timedelta) -> bool:
        """Return whether a file of that digest was stored at least this long ago.

        Raises:
            ServiceError: the store cannot be read.
        """
        with _working():
            stored_at = self._find_stored_time(sha256)
        return stored_at is not None and stored_at <= datetime.now(UTC) - age

    def delete(self, sha256: str) -> None:
        """Remove a file; removing it again changes nothing.

        Raises:
            ServiceError: the store does not work.
        """
        with _working():
            self._delete(make_key(sha256))
            self._delete(_list_key(sha256))

    def list_older_than(self, age: timedelta) -> list[str]:
        """Return the digests of all files that were stored at least this long ago, but for pieces of others.

        Raises:
            ServiceError: the store cannot be read.
        """
        paths = [path for folder in ("sha256", LIST_FOLDER) for path in self._list_older_paths(age, folder)]
        used = self.list_used_pieces()
        return [digest for digest in (path.rsplit("/", 1)[-1] for path in paths) if digest not in used]

    def put_part(self, upload: str, name: str, content: bytes) -> str:
        """Store a part of an upload that is not complete and return its key.

        Raises:
            ServiceError: the store cannot be written.
        """
        key = f"{PART_FOLDER}/{upload}/{name}"
        with _working():
            obstore.put(self._store, key, content)
        return key

    def part(self, key: str) -> memoryview:
        """Return a stored part.

        Raises:
            ServiceError: it is gone, or the store cannot be read.
        """
        with _working():
            content = obstore.get(self._store, key).bytes()
        return memoryview(content)

    def delete_part(self, key: str) -> None:
        """Remove one part; removing it again changes nothing.

        Raises:
            ServiceError: the store does not work.
        """
        with _working():
            self._delete(key)

    def delete_parts(self, upload: str) -> None:
        """Remove all parts of an upload, also those that no row names.

        Raises:
            ServiceError: the store does not work.
        """
        with _working():
            for batch in obstore.list(self._store, prefix=f"{PART_FOLDER}/{upload}"):
                self._delete([meta["path"] for meta in batch])

    def uploads_with_parts(self, age: timedelta) -> set[str]:
        """Return the uploads of which a part was stored at least this long ago.

        Raises:
            ServiceError: the store cannot be read.
        """
        return {path.split("/")[-2] for path in self._list_older_paths(age, PART_FOLDER)}

    def _list_older_paths(self, age: timedelta, folder: str) -> list[str]:
        oldest_kept = datetime.now(UTC) - age
        with _working():
            files = [meta for batch in obstore.list(self._store, prefix=folder) for meta in batch]
        return [meta["path"] for meta in files if meta["last_modified"] <= oldest_kept]

    def check(self) -> None:
        """Write and remove a small file with a name of its own: others may check at the same time.

        Raises:
            ServiceError: that does not work.
        """
        key = f"{PROBE_FOLDER}/{secrets.token_hex(8)}"
        with _working():
            obstore.put(self._store, key, b"ready")
            self._delete(key)

    def check_within(self, limit_s: float) -> None:
        """Check as `check` does, within a time limit [s]; a check that hangs continues and serves the next caller.

        Raises:
            ServiceError: the store does not work.
            TimeoutError: it has not answered in time.
        """
        with self._lock:
            if self._checking is None or self._checking.done():
                self._checking = Future()
                threading.Thread(target=self._run_check, args=(self._checking,), daemon=True).start()
            checking = self._checking
        checking.result(limit_s)

    def _run_check(self, checking: "Future[None]") -> None:
        try:
            self.check()
            checking.set_result(None)
        except ServiceError as error:
            checking.set_exception(error)

    def _find_stored_time(self, sha256: str) -> datetime | None:
        return self._find_time(_list_key(sha256)) or self._find_time(make_key(sha256))

    def _find_time(self, key: str) -> datetime | None:
        try:
            return obstore.head(self._store, key)["last_modified"]
        except (NotFoundError, FileNotFoundError):
            return None

    def _delete(self, keys: str | list[str]) -> None:
        """Remove files, of which somebody else may have removed some meanwhile."""
        try:
            obstore.delete(self._store, keys)
        except (NotFoundError, FileNotFoundError):
            if isinstance(keys, list):
                for key in keys:
                    self._delete(key)


def make_key(sha256: str) -> str:
    """Return the key of a digest; two characters make a folder, so that none gets too many files."""
    return f"sha256/{sha256[:2]}/{sha256}"


def _list_key(sha256: str) -> str:
    return f"{LIST_FOLDER}/{sha256[:2]}/{sha256}"


def cut(path: Path, places: Iterable[tuple[int, int]]) -> tuple[Piece, ...]:
    """Return the pieces of a file: these places of it, as (start, length), and what lies between them.

    A small piece has no digest, for it is not worth a file of its own.
    """
    edges = sorted({0, path.stat().st_size} | {edge for start, length in places for edge in (start, start + length)})
    pieces = []
    for start, end in pairwise(edges):
        piece = Piece(start=start, n_bytes=end - start)
        if piece.n_bytes >= _PIECE_BYTES:
            digest = hashlib.sha256()
            for data in _read_piece(path, piece):
                digest.update(data)
            piece = replace(piece, sha256=digest.hexdigest())
        pieces.append(piece)
    return tuple(pieces)


def _read_piece(path: Path, piece: Piece) -> Iterator[bytes]:
    with path.open("rb") as file:
        file.seek(piece.start)
        left = piece.n_bytes
        while left and (data := file.read(min(left, PART_BYTES))):
            left -= len(data)
            yield data


@contextmanager
def _working() -> Iterator[None]:
    """Tell callers of a store that does not work.

    Raises:
        ServiceError: the disk is full, or anything else went wrong.
    """
    try:
        yield
    except (BaseError, OSError) as error:
        if is_disk_full(error):
            raise storage_full() from error
        summary = " ".join(str(error).split())[:200]
        message = f"The file store does not work: {summary}. Try again later."
        raise ServiceError(ProblemCode.STORAGE_UNAVAILABLE, message) from error
