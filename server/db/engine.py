"""Connections and transactions: `Database` is made once per process and passed down."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TypeVar

import msgspec
import structlog
from sqlalchemy import Engine, create_engine, event, make_url
from sqlalchemy.engine.interfaces import DBAPIConnection
from sqlalchemy.exc import DBAPIError
from sqlalchemy.orm import Session, sessionmaker

ResultT = TypeVar("ResultT")
logger = structlog.get_logger(__name__)

INSUFFICIENT_RESOURCES = "53"
"""Class of the SQL states that say so."""

ENCODING = {"client_encoding": "utf8"}
"""Of connections: without it the driver gives bytes instead of text where the database has no encoding."""

LET_GO = (
    "SET idle_in_transaction_session_timeout = '10min'",
    "SET tcp_keepalives_idle = 10",
    "SET tcp_keepalives_interval = 5",
    "SET tcp_keepalives_count = 3",
)
"""When the database takes the locks from who has gone: a machine without power is noticed after 25 s instead of two
hours, a process that stands still after a while that is longer than storing a file takes."""

RETRY_PAUSES_S = (0.05, 0.1, 0.2, 0.5, 1.0)


class Database:
    """Engine and sessions of one PostgreSQL database."""

    def __init__(self, address: str, *, pool_size: int = 10) -> None:
        self.address = address
        # pre_ping: a pooled connection that died with the server is replaced before anybody uses it.
        self.engine: Engine = create_engine(
            sqlalchemy_url(address),
            pool_size=pool_size,
            max_overflow=20,
            pool_pre_ping=True,
            json_deserializer=msgspec.json.decode,
            connect_args={"connect_timeout": 15, "application_name": "vitac", **ENCODING},
        )
        event.listen(self.engine, "connect", _let_go_when_gone)
        self._sessions = sessionmaker(self.engine, expire_on_commit=False)

    @contextmanager
    def transaction(self) -> Iterator[Session]:
        """Return a session whose work is committed at the end of the block and rolled back on an error."""
        with self._sessions.begin() as session:
            yield session

    @contextmanager
    def snapshot(self) -> Iterator[Session]:
        """Return the same, but all statements see the database as it was at the first one."""
        with self.transaction() as session:
            session.connection(execution_options={"isolation_level": "REPEATABLE READ"})
            yield session

    def retrying(self, work: Callable[[Session], ResultT], *, give_up_after_s: float) -> ResultT:
        """Run a transaction again while the database is unavailable (restart, kill, full disk); for repeatable work.

        Raises:
            DBAPIError: the database stayed unavailable for longer than `give_up_after_s`, or another error occurred.
        """
        deadline = time.monotonic() + give_up_after_s
        failures = 0
        while True:
            try:
                with self.transaction() as session:
                    return work(session)
            except DBAPIError as error:
                if not is_temporary(error) or time.monotonic() > deadline:
                    raise
                logger.warning("database_unavailable", failures=failures + 1)
                time.sleep(RETRY_PAUSES_S[min(failures, len(RETRY_PAUSES_S) - 1)])
                failures += 1

    def dispose(self) -> None:
        """Close all pooled connections."""
        self.engine.dispose()


def _let_go_when_gone(connection: DBAPIConnection, _: object) -> None:
    cursor = connection.cursor()
    cursor.execute("; ".join(LET_GO))
    cursor.close()
    connection.commit()


def is_connection_loss(error: DBAPIError) -> bool:
    """Return whether the server is unavailable, starting or shutting down, as opposed to a statement that is wrong."""
    state = getattr(error.orig, "sqlstate", None)
    # No state: the connection broke or could not be made. 57P01-3: shutdown, crash, starting. 08: connection errors.
    is_operational = type(error.orig).__name__ in {
        "OperationalError",
        "AdminShutdown",
        "CrashShutdown",
        "CannotConnectNow",
    }
    return error.connection_invalidated or (is_operational and (state is None or state[:2] in {"08", "57"}))


def is_temporary(error: DBAPIError) -> bool:
    """Return whether the same transaction may succeed later: the server is unavailable or lacks disk or memory."""
    state = getattr(error.orig, "sqlstate", None)
    return is_connection_loss(error) or (state is not None and state.startswith(INSUFFICIENT_RESOURCES))


def sqlalchemy_url(address: str) -> str:
    """Return the address with our driver named; libpq's form (`postgresql://`) is what settings and files hold."""
    url = make_url(address).set(drivername="postgresql+psycopg")
    return url.render_as_string(hide_password=False)
