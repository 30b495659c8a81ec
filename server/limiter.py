"""Counts what one client may do: events in a time window, and things at the same time.

Stored in files of the state directory, so that all server processes of a machine count together, and a killed one no
longer counts.
"""

import fcntl
import hashlib
import os
import struct
import time
from array import array
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from ipaddress import IPv4Address, IPv6Network, ip_address
from pathlib import Path
from typing import BinaryIO

from .errors import ProblemCode, ServiceError

UPLOADS = "uploads at the same time"
"""What is counted at the upload routes, in words."""
SLOWED_BY_S = 3.0
"""How long an attempt to sign in waits as a member who is being attacked from several addresses."""
_LOCK = struct.Struct("hhqqi0q")  # struct flock: kind, whence, start, length, process id
_KEY_BYTES = 5
_PLACES = 1 << 20
"""Number of bytes of the file that belong to a key."""


class WindowLimiter:
    """At most `limit` events for a key within `window_s` seconds; a key has a file with the times of its events."""

    def __init__(self, folder: Path, *, limit: int, window_s: float, clock: Callable[[], float] = time.time) -> None:
        self._folder = folder
        self._limit = limit
        self._window_s = window_s
        self._clock = clock
        self._cleaned_at = float("-inf")

    def note(self, key: str, what: str) -> None:
        """Count one event.

        Raises:
            ServiceError: too many; `retry_after_s` says when the next one is possible.
        """
        if not self.is_within(key):
            raise self._refusal(key, what)

    def is_within(self, key: str) -> bool:
        """Count one event unless the limit is reached; return whether it was counted."""
        self._remove_expired(self._clock())
        with self._locked(self._folder / _digest(key).hex()) as file:
            recent = self._recent(file)
            if len(recent) >= self._limit:
                return False
            recent.append(self._clock())
            file.seek(0)
            file.write(recent.tobytes())
            file.truncate()
            return True

    def _refusal(self, key: str, what: str) -> ServiceError:
        with self._locked(self._folder / _digest(key).hex()) as file:
            now = self._clock()
            wait_s = max(1, round(min(self._recent(file), default=now) + self._window_s - now))
        return ServiceError(
            ProblemCode.TOO_MANY_REQUESTS,
            f"At most {self._limit} {what} in {self._window_s:.0f} s are possible; wait {wait_s} s.",
            retry_after_s=wait_s,
        )

    def _recent(self, file: BinaryIO) -> "array[float]":
        """Return the times of the events within the window."""
        now = self._clock()
        return array("d", [at for at in _times(file) if now - self._window_s < at <= now])

    @contextmanager
    def _locked(self, path: Path) -> Iterator[BinaryIO]:
        """Open a file that nobody else reads or removes meanwhile."""
        while True:
            with _open(path) as file:
                fcntl.flock(file, fcntl.LOCK_EX)
                if os.fstat(file.fileno()).st_nlink:  # else it was removed before we had it
                    yield file
                    return

    def _remove_expired(self, now: float) -> None:
        if now - self._cleaned_at < self._window_s:
            return
        self._cleaned_at = now
        for path in self._folder.glob("*"):
            with self._locked(path) as file:
                if all(at <= now - self._window_s for at in _times(file)):
                    path.unlink()


@dataclass(frozen=True, kw_only=True)
class SignInLimiters:
    """Count sign-in attempts with a password, so that nobody guesses one, and nobody locks a member out by guessing.

    Attributes:
        of_address: of one client, whomever it tries.
        of_member: of one name in one team, whether there is such a member or not: from one address, or on one device
            that has signed in before. From all addresses together more than that are slowed down, not refused.
        at_once: passwords that are being checked for one address or device.
    """

    of_address: WindowLimiter
    of_member: WindowLimiter
    at_once: "ConcurrencyLimiter"

    def note(self, address: str, member: str, *, device: str | None = None) -> float:
        """Count one attempt and return how long it has to wait [s].

        Args:
            address: of the client.
            member: name and team.
            device: on which that member has signed in before; None: none.

        Raises:
            ServiceError: too many.
        """
        if device is not None:
            self.of_member.note(f"{member}\ndevice {device}", "sign-in attempts on one device")
            return 0.0
        self.of_address.note(address, "sign-in attempts from one address")
        self.of_member.note(f"{member}\n{address}", "sign-in attempts as one member from one address")
        return 0.0 if self.of_member.is_within(member) else SLOWED_BY_S

    def place(self, address: str, *, device: str | None = None) -> AbstractContextManager[None]:
        """Count an attempt while its password is checked: one address cannot fill the places of all.

        Raises:
            ServiceError: this address has reached its limit of simultaneous checks.
        """
        return self.at_once.one(device or address, "passwords of one address or device being checked")


class ConcurrencyLimiter:
    """At most `limit` things of a key at the same time.

    Each one holds a lock on a byte of the file, at a place that belongs to its key. It is freed with the process.
    """

    def __init__(self, path: Path, limit: int) -> None:
        self._path = path
        self._limit = limit

    @contextmanager
    def one(self, key: str, what: str, *, share: float = 1.0) -> Iterator[None]:
        """Count one thing while the block runs; `share`: of the limit, which this key may use.

        Raises:
            ServiceError: the limit is reached.
        """
        limit = max(1, int(self._limit * share))
        with self.place(key, limit) as is_free:
            if not is_free:
                raise ServiceError(
                    ProblemCode.TOO_MANY_REQUESTS, f"At most {limit} {what} are possible; wait for one to end."
                )
            yield

    @contextmanager
    def place(self, key: str, limit: int) -> Iterator[bool]:
        """Count one thing while the block runs if there is a place among `limit`; yield whether there is."""
        first = int.from_bytes(_digest(key)[:_KEY_BYTES]) * _PLACES
        with _open(self._path) as file:
            yield any(_lock_byte(file, place) for place in range(first, first + min(limit, _PLACES)))


def _digest(key: str) -> bytes:
    return hashlib.sha256(key.encode()).digest()


def _times(file: BinaryIO) -> Iterable[float]:
    content = file.read()
    return array("d", content[: len(content) // 8 * 8])  # on a full disk the last one may be cut off


def _open(path: Path) -> BinaryIO:
    path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    return os.fdopen(os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600), "r+b", buffering=0)


def _lock_byte(file: BinaryIO, place: int) -> bool:
    """Lock one byte for as long as the file is open; return whether nobody else, in this process or others, had it."""
    try:
        fcntl.fcntl(file, fcntl.F_OFD_SETLK, _LOCK.pack(fcntl.F_WRLCK, os.SEEK_SET, place, 1, 0))
    except BlockingIOError:
        return False
    return True


def client_key(host: str | None) -> str:
    """Return whom a limit counts for: an address, or of IPv6 the network of 64 bits that one client has to itself."""
    try:
        address = ip_address(host or "")
    except ValueError:
        return host or "unknown"
    if isinstance(address, IPv4Address):
        return str(address)
    if address.ipv4_mapped is not None:
        return str(address.ipv4_mapped)
    return str(IPv6Network((address, 64), strict=False))
