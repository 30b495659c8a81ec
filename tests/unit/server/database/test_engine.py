import json

import psycopg
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from sqlalchemy import Text, cast, literal, select, text
from sqlalchemy.dialects.postgresql import JSONB
from sqlalchemy.exc import DBAPIError, OperationalError
from sqlalchemy.orm import Session
from vitac.server.database import engine
from vitac.server.database.engine import Database, is_cancelled, is_connection_loss, sqlalchemy_url
from vitac.server.database.models import Worker


def lose_connection(session: Session) -> None:
    session.execute(text("SELECT pg_terminate_backend(pg_backend_pid())"))


def test_work_is_repeated_until_the_database_is_back(database: Database) -> None:
    tries: list[int] = []

    def work(session: Session) -> str:
        tries.append(len(tries))
        if len(tries) < 4:
            lose_connection(session)
        return "done"

    assert database.retrying(work, give_up_after_s=30.0) == "done"
    assert tries == [0, 1, 2, 3]


def test_work_of_a_lost_transaction_is_not_half_done(database: Database) -> None:
    def work(session: Session) -> None:
        session.execute(text("INSERT INTO audit_log (actor, action, subject, after) VALUES ('a', 'b', 'c', '{}')"))
        if len(tries) == 0:
            tries.append(1)
            lose_connection(session)

    tries: list[int] = []
    database.retrying(work, give_up_after_s=30.0)
    with database.transaction() as session:
        assert session.scalar(text("SELECT count(*) FROM audit_log")) == 1


def test_a_statement_that_takes_too_long_is_ended(database: Database) -> None:
    impatient = Database(database.address, statement_timeout_s=0.05)
    try:
        with pytest.raises(DBAPIError) as ended, impatient.reading() as session:
            session.execute(text("SELECT pg_sleep(60)"))
    finally:
        impatient.dispose()
    assert is_cancelled(ended.value)
    assert not is_connection_loss(ended.value)


JSON_VALUES = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-(10**40), 10**40)
    | st.floats(allow_nan=False, allow_infinity=False)
    | st.text(st.characters(codec="utf-8", exclude_characters="\0")),
    lambda inner: st.lists(inner) | st.dictionaries(st.text("abc\u00e9\u4e2d", max_size=3), inner),
    max_leaves=20,
)


@settings(max_examples=10, suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow])
@given(values=st.lists(JSON_VALUES, min_size=5))
def test_json_is_read_to_the_last_bit_of_a_number(database: Database, values: list[object]) -> None:
    """Scores and result hashes are made of what is read."""
    stored = cast(literal(values, JSONB), JSONB)
    with database.transaction() as session:
        read, written = session.execute(select(stored, cast(stored, Text))).one()
    assert repr(read) == repr(json.loads(written))


def test_a_snapshot_does_not_see_what_others_write_meanwhile(database: Database) -> None:
    count = text("SELECT count(*) FROM audit_log")
    with database.snapshot() as session:
        assert session.scalar(count) == 0
        with database.transaction() as other:
            other.execute(text("INSERT INTO audit_log (actor, action, subject, after) VALUES ('a', 'b', 'c', '{}')"))
        assert session.scalar(count) == 0
    with database.transaction() as session:
        assert session.scalar(count) == 1
        assert session.scalar(text("SHOW transaction_isolation")) == "read committed", "the next one is as before"


def test_work_is_repeated_while_the_disk_of_the_database_is_full(database: Database) -> None:
    tries: list[int] = []

    def work(session: Session) -> str:
        tries.append(1)
        if len(tries) < 3:
            session.execute(text("DO $$ BEGIN RAISE disk_full; END $$"))
        return "done"

    assert database.retrying(work, give_up_after_s=30.0) == "done"
    assert len(tries) == 3


def test_who_stands_still_is_cut_off_after_a_transaction_that_failed_too(database: Database) -> None:
    with pytest.raises(DBAPIError), database.transaction() as session:
        session.execute(text("SELECT no_such_column"))
    with database.transaction() as session:
        assert session.scalar(text("SHOW idle_in_transaction_session_timeout")) == "10min"


def test_patience_ends(database: Database) -> None:
    with pytest.raises(DBAPIError):
        database.retrying(lose_connection, give_up_after_s=0.0)


def test_wrong_statement_is_not_repeated(database: Database) -> None:
    tries: list[int] = []

    def work(session: Session) -> None:
        tries.append(1)
        session.execute(text("SELECT 1 / 0"))

    with pytest.raises(DBAPIError) as failed:
        database.retrying(work, give_up_after_s=30.0)
    assert not is_connection_loss(failed.value)
    assert len(tries) == 1


def test_server_that_is_not_there_is_a_connection_loss() -> None:
    away = Database("postgresql://nobody@/none?host=/nowhere")
    with pytest.raises(DBAPIError) as failed, away.transaction() as session:
        session.execute(text("SELECT 1"))
    assert is_connection_loss(failed.value)


@pytest.mark.parametrize("trusted_for_s", [0.0, 30.0])
def test_pooled_connection_that_died_is_replaced(
    database: Database, monkeypatch: pytest.MonkeyPatch, trusted_for_s: float
) -> None:
    """Whether it is asked first, or trusted as it was used a moment ago."""
    monkeypatch.setattr(engine, "TRUSTED_FOR_S", trusted_for_s)
    for opened in (database.transaction, database.reading):
        with opened() as session:
            backend = session.scalar(text("SELECT pg_backend_pid()"))
        with psycopg.connect(database.address) as other:
            other.execute("SELECT pg_terminate_backend(%s, 5000)", [backend])
        with opened() as session:
            assert session.scalar(text("SELECT pg_backend_pid()")) != backend


def test_pooled_connection_is_asked_whether_it_works_only_after_a_while(
    database: Database, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The database tells the last statement of each connection."""
    database.dispose()  # so that its pool has one connection
    last = []
    with database.transaction() as session:
        pid = session.scalar(text("SELECT pg_backend_pid()"))
    for trusted_for_s in (30.0, 0.0):
        monkeypatch.setattr(engine, "TRUSTED_FOR_S", trusted_for_s)
        with database.engine.connect(), psycopg.connect(database.address) as other:
            last.append(other.execute("SELECT query FROM pg_stat_activity WHERE pid = %s", [pid]).fetchone())
    assert last == [("COMMIT",), ("ROLLBACK",)]


def test_reading_begins_no_transaction_and_leaves_the_connection_as_it_was(database: Database) -> None:
    added = text("INSERT INTO audit_log (actor, action, subject, after) VALUES ('a', 'b', 'c', '{}')")
    with database.reading() as session:
        assert session.scalar(text("SELECT now()")) < session.scalar(text("SELECT now()"))
    with database.engine.connect() as connection:
        connection.execute(added)  # and never commit it
    with database.reading() as session:
        assert session.scalar(text("SELECT count(*) FROM audit_log")) == 0


def test_reading_refuses_changes_of_rows_that_would_be_lost(database: Database) -> None:
    with pytest.raises(RuntimeError, match="only reads"), database.reading() as session:
        session.add(Worker())


@pytest.mark.parametrize("scheme", ["postgresql", "postgres+psycopg", "postgresql+psycopg"])
def test_address_gets_the_driver_and_keeps_password_and_socket_folder(scheme: str) -> None:
    address = f"{scheme}://user:pass%40word@/name?host=%2Ftmp%2Fx"
    assert sqlalchemy_url(address) == "postgresql+psycopg://user:pass%40word@/name?host=%2Ftmp%2Fx"


def test_a_server_that_takes_connections_and_says_nothing_is_unavailable() -> None:
    error = OperationalError("SELECT 1", {}, psycopg.errors.ConnectionTimeout("connection timeout expired"))
    assert is_connection_loss(error)
