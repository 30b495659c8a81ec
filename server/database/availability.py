"""Waits for a database that starts, recovers or restarts, and says why it fails; called by `services` and commands."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import structlog
from psycopg.conninfo import conninfo_to_dict, make_conninfo
from psycopg.pq import PGconn, Ping
from sqlalchemy.exc import DBAPIError
from vitac.errors import VitacError

from .engine import Database, has_no_free_connection, is_cancelled, is_connection_loss, is_temporary

logger = structlog.get_logger(__name__)

POLL_S = 0.2
NOTICE_EVERY_S = 10.0
REFUSALS = 3
"""So often a server that takes connections may refuse ours; then it is no restart but a wrong password or name."""

_PING_TIMEOUT_S = 5


class DatabaseUnreachable(VitacError):
    """No database answers at the configured address, or it refuses us, or its schema cannot be migrated."""

    @classmethod
    def from_driver(cls, error: DBAPIError) -> "DatabaseUnreachable":
        """Return the error that says in one line what the driver said."""
        if has_no_free_connection(error.orig):
            return cls("The database has no free connection: run fewer processes, or raise its max_connections.")
        return cls(f"The database cannot be used: {' '.join(str(error.orig).split())}.")


@contextmanager
def failures_explained(limit_s: float) -> Iterator[None]:
    """Let a block that changes nothing when it fails say why: the database was lost, or took longer than the limit.

    Raises:
        DatabaseUnreachable: one of the two.
    """
    try:
        yield
    except DBAPIError as error:
        if is_cancelled(error):
            raise DatabaseUnreachable(
                f"The database took longer than {limit_s:.0f} s, perhaps because a lock stands in the way "
                "(docs/monitoring.md says how to find it). Nothing was changed."
            ) from error
        if is_temporary(error):
            raise DatabaseUnreachable.from_driver(error) from error
        raise


def once_available(database: Database, work: Callable[[Database], None], *, patience_s: float) -> None:
    """Do the first work on a database as soon as it takes connections.

    A server that starts, recovers or shuts down is waited for without limit, since it says that it is there; for one
    that does not answer at all the limit is `patience_s`.

    Args:
        database: whose address is tried.
        work: done again if the connection is lost meanwhile.
        patience_s: how long nobody may answer there [s].

    Raises:
        DatabaseUnreachable: nobody answered in time, or the server refused us.
    """
    refusals = 0
    while True:
        _wait_until_accepting(database.address, patience_s)
        try:
            work(database)
            return
        except DBAPIError as error:
            refusals += 1
            if not is_connection_loss(error) or refusals == REFUSALS:
                raise DatabaseUnreachable.from_driver(error) from error
        time.sleep(POLL_S)


def _wait_until_accepting(address: str, patience_s: float) -> None:
    last_answer = time.monotonic()
    noticed = float("-inf")
    while (state := _ping(address)) is not Ping.OK:
        now = time.monotonic()
        if state is Ping.REJECT:
            last_answer = now
        elif state is Ping.NO_ATTEMPT or now - last_answer > patience_s:
            raise DatabaseUnreachable(f"No database answers at {_place(address)} (waited {now - last_answer:.0f} s).")
        if now - noticed > NOTICE_EVERY_S:
            noticed = now
            logger.warning("database_awaited", place=_place(address), starts_or_stops=state is Ping.REJECT)
        time.sleep(POLL_S)


def _ping(address: str) -> Ping:
    """Return whether the server takes connections, refuses them while it starts or stops, or does not answer."""
    return Ping(PGconn.ping(make_conninfo(address, connect_timeout=_PING_TIMEOUT_S).encode()))


def _place(address: str) -> str:
    """Return host and port without the rest of the address, which may hold a password."""
    parameters = conninfo_to_dict(address)
    return f"{parameters.get('host', 'the local socket')} port {parameters.get('port', 5432)}"
