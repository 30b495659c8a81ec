"""Connections and transactions: `Database` is made once per process and passed down."""

import select
import time
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import contextmanager
from copy import copy
from functools import partial
from typing import Self, TypeVar
from uuid import UUID

import msgspec
import psycopg
import structlog
from sqlalchemy import ColumnElement, Engine, Uuid, bindparam, create_engine, event, func, literal, make_url
from sqlalchemy.dialects.postgresql import ARRAY
from sqlalchemy.engine.interfaces import DBAPIConnection
from sqlalchemy.exc import DBAPIError, InvalidatePoolError
from sqlalchemy.orm import InstrumentedAttribute, Session, sessionmaker
from sqlalchemy.pool import ConnectionPoolEntry

ResultT = TypeVar("ResultT")
logger = structlog.get_logger(__name__)

INSUFFICIENT_RESOURCES = "53"
"""Class of SQL states of a database without resources."""

QUERY_CANCELED = "57014"
ENCODING = {"client_encoding": "utf8"}
"""Setting of all connections: without it the driver gives bytes instead of text where the database has no encoding."""

READS_ONLY = "reads_only"
"""Key of `Session.info` in a session of `Database.reading`: what it has read once need not be read again."""

LIMITS = (
    "SET idle_in_transaction_session_timeout = '10min'",
    "SET tcp_keepalives_idle = 10",
    "SET tcp_keepalives_interval = 5",
    "SET tcp_keepalives_count = 3",
)
"""After these times the database releases the locks of a client that is gone: 25 s for a machine without power (two
hours by default), and longer than storing a file takes for a process that hangs."""

TRUSTED_FOR_S = 30.0
"""A connection that was used within this time is not tested before use, unless it has data to read: the database says
when it closes a connection, and nothing between the two forgets connections sooner than this."""

RETRY_PAUSES_S = (0.05, 0.1, 0.2, 0.5, 1.0)


class Database:
    """Engine and sessions of one PostgreSQL database.

    Args:
        address: with which the service works.
        owner_address: of the role that owns the tables, to migrate and restore; None: that of the service.
        statement_timeout_s: after which the database ends a statement; None: without limit.
    """

    def __init__(
        self,
        address: str,
        *,
        owner_address: str | None = None,
        statement_timeout_s: float | None = None,
    ) -> None:
        self.address = address
        self.owner_address = owner_address or address
        self.engine: Engine = create_engine(
            sqlalchemy_url(address),
            pool_size=10,
            max_overflow=20,
            json_deserializer=msgspec.json.decode,
            connect_args={"connect_timeout": 15, "application_name": "vitac", **ENCODING},
        )
        limits = [] if statement_timeout_s is None else [f"SET statement_timeout = {round(1000 * statement_timeout_s)}"]
        event.listen(self.engine, "connect", partial(_limit_connection, limits))
        event.listen(self.engine, "checkin", _note_use)
        event.listen(self.engine, "checkout", _replace_if_dead)
        self.is_trial = False
        """Whether nothing is kept: what would be refused is refused, and then all is rolled back."""
        self._sessions = sessionmaker(self.engine, expire_on_commit=False)
        self._readers = sessionmaker(self.engine, autoflush=False)

    @contextmanager
    def transaction(self) -> Iterator[Session]:
        """Return a session whose work is committed at the end of the block and rolled back on an error."""
        with self._sessions.begin() as session:
            yield session
            if self.is_trial:
                session.flush()
                session.rollback()

    def make_trial(self) -> Self:
        """Return the same database, whose transactions are rolled back at the end of the block."""
        trial = copy(self)
        trial.is_trial = True
        return trial

    @contextmanager
    def reading(self) -> Iterator[Session]:
        """Return a session to read with, in which each statement stands alone.

        It sees what one of `transaction` would, where each statement sees what is committed by then, but nothing is
        begun and committed: two exchanges with the database less. One statement may change something.

        Raises:
            RuntimeError: a row was changed as an object, which would be lost.
        """
        with self._readers(info={READS_ONLY: True}) as session:
            session.connection(execution_options={"isolation_level": "AUTOCOMMIT"})
            yield session
            if session.new or session.dirty or session.deleted:
                raise RuntimeError("A session that only reads was given rows to change; use Database.transaction().")

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
                logger.warning("database_unavailable", failures=failures + 1, error=" ".join(str(error.orig).split()))
                time.sleep(RETRY_PAUSES_S[min(failures, len(RETRY_PAUSES_S) - 1)])
                failures += 1

    def dispose(self) -> None:
        """Close all pooled connections."""
        self.engine.dispose()


def _limit_connection(limits: Sequence[str], connection: DBAPIConnection, _: object) -> None:
    cursor = connection.cursor()
    cursor.execute("; ".join((*LIMITS, *limits)))
    cursor.close()
    connection.commit()


def _note_use(_: DBAPIConnection | None, entry: ConnectionPoolEntry) -> None:
    entry.info["used_at"] = time.monotonic()


def _replace_if_dead(connection: DBAPIConnection, entry: ConnectionPoolEntry, _: object) -> None:
    """Have a pooled connection that died with the server replaced before anybody uses it."""
    used_at: float | None = entry.info.get("used_at")
    if used_at is None:  # made just now
        return
    try:
        if time.monotonic() - used_at < TRUSTED_FOR_S and not _has_said_something(connection):
            return
        connection.cursor().execute("SELECT 1")
        connection.rollback()
    except psycopg.Error as error:
        raise InvalidatePoolError from error


def _has_said_something(connection: DBAPIConnection) -> bool:
    """Return whether something was sent that nobody asked for, as when the server ends."""
    poll = select.poll()
    poll.register(connection.fileno(), select.POLLIN)
    return bool(poll.poll(0))


def is_cancelled(error: DBAPIError) -> bool:
    """Return whether the database has ended a statement because it took too long."""
    return getattr(error.orig, "sqlstate", None) == QUERY_CANCELED


def has_no_free_connection(error: BaseException | None) -> bool:
    """Return whether the driver says that the database runs, and all connections that it takes are in use.

    It gives an error of connecting no state, so that the text has to tell.
    """
    return any(text in str(error) for text in ("too many clients", "too many connections", "connection slots"))


def is_connection_loss(error: DBAPIError) -> bool:
    """Return whether the server is unavailable, starting or shutting down, as opposed to a statement that is wrong."""
    state = getattr(error.orig, "sqlstate", None)
    # No state: the connection broke or could not be made. 57P01-3: shutdown, crash, starting. 08: connection errors.
    is_operational = type(error.orig).__name__ in {
        "OperationalError",
        "ConnectionTimeout",
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


def among(column: InstrumentedAttribute[UUID], ids: Collection[UUID]) -> ColumnElement[bool]:
    """Return the condition with all ids in one parameter, so that the statement is the same however many there are.

    With a parameter for each (`in_`), driver and database read a statement of many kilobytes each time.
    """
    return column == func.any(literal(list(ids), ARRAY(Uuid)))


def among_parameter(column: InstrumentedAttribute[UUID], name: str) -> ColumnElement[bool]:
    """Return the same for a statement that is put together once: the list of ids is its parameter of that name."""
    return column == func.any(bindparam(name, type_=ARRAY(Uuid)))
