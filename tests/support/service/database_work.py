"""Counts what the database does for a piece of work: rows that it reads, statements that it is given."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from sqlalchemy import event, text
from sqlalchemy.orm import Session

ROWS_READ = """
    SELECT relname, coalesce(seq_tup_read, 0) + coalesce(idx_tup_fetch, 0) AS rows_read
    FROM pg_stat_xact_user_tables
"""


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


def _rows_read(session: Session) -> dict[str, int]:
    return {row.relname: row.rows_read for row in session.execute(text(ROWS_READ))}
