"""Passwords of members, stored as argon2id hashes. Called by `members` and by the sign-in page."""

import threading

from argon2 import PasswordHasher
from argon2.exceptions import InvalidHashError, VerifyMismatchError

from ..errors import ProblemCode, ServiceError

MIN_LENGTH, MAX_LENGTH = 12, 256
_HASHER = PasswordHasher()
_AT_ONCE = threading.BoundedSemaphore(2)
"""One hash takes 64 MiB; more at once would let strangers fill the server's memory by signing in."""
_NOBODYS_HASH = "$argon2id$v=19$m=65536,t=3,p=4$0K49dMvkXYAqxV0QBqWYMA$9V2Ji0zl4YFr1LruVRPdbSoMam2s9VnZvbqb9vVdMZY"
"""Checked where there is no password, so that the time of the answer does not say who has one."""


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
    with _AT_ONCE:
        return _HASHER.hash(password)


def is_right(password: str, kept: str | None) -> bool:
    """Return whether a password belongs to a hash; never, but after as long, where there is none."""
    if len(password) > MAX_LENGTH:
        return False
    try:
        with _AT_ONCE:
            _HASHER.verify(_NOBODYS_HASH if kept is None else kept, password)
    except (VerifyMismatchError, InvalidHashError):
        return False
    return kept is not None
