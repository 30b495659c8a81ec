"""Tells what the database does: rows that it reads for a piece of work, statements that it is given, waiting."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from sqlalchemy import event, text
from sqlalchemy.orm import Session
from vitac.server.database.engine import Database

ROWS_READ = """
    SELECT relname, coalesce(seq_tup_read, 0) + coalesce(idx_tup_fetch, 0) AS rows_read
    FROM pg_stat_xact_user_tables
"""

WAITING = "SELECT count(*) FROM pg_stat_activity WHERE datname = current_database() AND wait_event_type = 'Lock'"


class DatabaseWork:
    """What was done inside `database_work`; filled at its end."""

    rows_read: dict[str, int]
    """Rows read, by table; those that an index alone answered are not counted."""

    statements: int


@contextmanager
def database_work(session: Session) -> Iterator[DatabaseWork]:
    """Count inside the block, which stays in the session's transaction."""
    work, before, given = DatabaseWork(), _rows_read(session), [0]

    def count(*_: Any) -> None:
        given[0] += 1

    connection = session.connection()
    event.listen(connection, "before_cursor_execute", count)
    try:
        yield work
    finally:
        event.remove(connection, "before_cursor_execute", count)
        work.statements = given[0]
        work.rows_read = {table: rows - before.get(table, 0) for table, rows in _rows_read(session).items()}


def is_waiting_for_a_lock(database: Database) -> bool:
    """Return whether a connection to this database waits for another one."""
    with database.transaction() as session:
        return bool(session.scalar(text(WAITING)))


def _rows_read(session: Session) -> dict[str, int]:
    return {row.relname: row.rows_read for row in session.execute(text(ROWS_READ))}
