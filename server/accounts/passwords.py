"""Passwords of members, stored as argon2id hashes, which are computed in threads of their own. Called by `members`."""

import asyncio
import threading
from collections.abc import Awaitable, Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import ParamSpec, TypeVar

from argon2 import PasswordHasher
from argon2.exceptions import InvalidHashError, VerifyMismatchError

from ..errors import ProblemCode, ServiceError

ResultT = TypeVar("ResultT")
Given = ParamSpec("Given")

MIN_LENGTH, MAX_LENGTH = 12, 256
WAITING = 24
"""Works that one thread may have before it; the last of them waits about half a second."""
RETRY_AFTER_S = 5
_HASHER = PasswordHasher(time_cost=2, memory_cost=19_456, parallelism=1)
"""The least that OWASP's Password Storage Cheat Sheet recommends: strangers cost 0.02 s of CPU with each guess, and all
who sign in at the same time wait for each other."""
_NOBODYS_HASH = "$argon2id$v=19$m=19456,t=2,p=1$j+Mg78uExQ4ExfMjt2INXQ$Y7chdM75VevtzVZRC6AEIuTNEcbMmgFTwQAQnvE/7W4"
"""Checked where there is no password, so that the time of the answer does not say who has one."""


class PasswordThread:
    """A thread for works that compute a hash: one after the other, since each takes 19 MiB and 0.02 s of CPU.

    No thread that answers requests waits for it, and the works have no transaction open while they compute.
    """

    def __init__(self, name: str) -> None:
        self._executor = ThreadPoolExecutor(1, name)
        self._places = threading.BoundedSemaphore(WAITING)

    def submit(self, work: Callable[Given, ResultT], *args: Given.args, **kwargs: Given.kwargs) -> Future[ResultT]:
        """Have a work done.

        Raises:
            ServiceError: too many wait.
        """
        if not self._places.acquire(blocking=False):
            raise ServiceError(
                ProblemCode.TOO_MANY_REQUESTS,
                f"{WAITING} passwords are being checked, no more can wait; try again in {RETRY_AFTER_S} s.",
                retry_after_s=RETRY_AFTER_S,
            )
        future = self._executor.submit(work, *args, **kwargs)
        future.add_done_callback(lambda _: self._places.release())
        return future

    def run(self, work: Callable[Given, ResultT], *args: Given.args, **kwargs: Given.kwargs) -> ResultT:
        """Have a work done and wait for it.

        Raises:
            ServiceError: as `submit`.
        """
        return self.submit(work, *args, **kwargs).result()

    def wait_for(self, work: Callable[Given, ResultT], *args: Given.args, **kwargs: Given.kwargs) -> Awaitable[ResultT]:
        """Have a work done and wait for it in an event loop.

        Raises:
            ServiceError: as `submit`.
        """
        return asyncio.wrap_future(self.submit(work, *args, **kwargs))


UNKNOWN_DEVICES = PasswordThread("passwords")
KNOWN_DEVICES = PasswordThread("passwords-known")
"""For those who are signed in, or were on that device: strangers cannot fill its places."""


def hashed(password: str) -> str:
    """Return the hash of a password.

    Raises:
        ServiceError: it is too short or too long.
    """
    if not MIN_LENGTH <= len(password) <= MAX_LENGTH:
        raise ServiceError(
            ProblemCode.INVALID_REQUEST,
            f"Expected a password of {MIN_LENGTH} to {MAX_LENGTH} characters, got {len(password)}.",
        )
    return _HASHER.hash(password)


def is_right(password: str, stored: str | None) -> bool:
    """Return whether a password belongs to a hash; never, but after as long, where there is none."""
    if len(password) > MAX_LENGTH:
        return False
    try:
        _HASHER.verify(_NOBODYS_HASH if stored is None else stored, password)
    except (VerifyMismatchError, InvalidHashError):
        return False
    return stored is not None
