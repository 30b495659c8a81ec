"""Advisory locks of the database: all keys in one place, so that no two pieces of work share one by mistake."""

from enum import IntEnum

from sqlalchemy import Connection, text
from sqlalchemy.orm import Session


class AdvisoryLock(IntEnum):
    """Work that one process of the service does at a time; the first bytes of each key spell `vita`."""

    SCHEMA_UPGRADE = 0x7669_7461_6301  # of several processes that start at once, one migrates and the others wait
    SWEEP = 0x7669_7461_6302  # one sweep at a time is enough
    SUPERSEDE = 0x7669_7461_6303  # two processes would begin the same evaluation again twice
    PLAYBACK_OF_REQUESTER = 0x7669_7461_6304  # two requests at once would exceed the limits
    PLAYBACK_OF_EPISODE = 0x7669_7461_6305  # two requests at once would make the same playback twice
    STORED_FILE = 0x7669_7461_6306  # a file must not be removed while it is uploaded again
    RECEIPTS = 0x7669_7461_6307  # two receipts at once would follow the same one


def try_lock(session: Session, lock: AdvisoryLock) -> bool:
    """Take a lock until the end of the transaction; whether nobody else holds it."""
    return bool(session.scalar(text("SELECT pg_try_advisory_xact_lock(:key)"), {"key": lock.value}))


def wait_for_lock(connection: Connection, lock: AdvisoryLock) -> None:
    """Take a lock until the connection is closed, after whoever holds it now."""
    connection.execute(text("SELECT pg_advisory_lock(:key)"), {"key": lock.value})


def wait_for_turn(session: Session, lock: AdvisoryLock, name: str) -> None:
    """Take the lock of a name until the end of the transaction, after whoever holds it now."""
    session.execute(
        text("SELECT pg_advisory_xact_lock(hashtextextended(:name, :key))"), {"name": name, "key": lock.value}
    )
