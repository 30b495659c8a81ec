import os
import shutil
import signal
import threading
from contextlib import suppress

import psycopg
import pytest
from databases import state_directory
from sqlalchemy.exc import OperationalError
from structlog.testing import capture_logs
from vitac.server.database.availability import REFUSALS, DatabaseUnreachable, once_available
from vitac.server.database.embedded import EmbeddedPostgres
from vitac.server.database.engine import Database
from worker_fakes import eventually


def test_a_server_that_refuses_connections_while_it_stops_and_starts_is_waited_for() -> None:
    """A smart shutdown: the server refuses new connections for as long as an old one stays."""
    folder = state_directory()
    done = threading.Event()
    with EmbeddedPostgres(folder) as postgres, capture_logs() as events:
        database = Database(postgres.cluster.dsn())
        with psycopg.connect(database.address):
            assert postgres.server_pid is not None
            os.kill(postgres.server_pid, signal.SIGTERM)
            eventually(lambda: refuses(database.address))
            waiting = threading.Thread(
                target=once_available, args=(database, lambda _: done.set()), kwargs={"patience_s": 20.0}
            )
            waiting.start()
            eventually(lambda: any(event["event"] == "database_awaited" for event in events))
            assert not done.is_set()
        waiting.join()
        assert done.is_set()
        database.dispose()
    shutil.rmtree(folder)


def refuses(address: str) -> bool:
    try:
        psycopg.connect(address).close()
    except psycopg.OperationalError as error:
        return "shutting down" in str(error)
    return False


def test_work_is_done_again_after_a_lost_connection_but_not_for_ever(database: Database) -> None:
    tried = []

    def lose(_: Database) -> None:
        tried.append(1)
        raise OperationalError("SELECT 1", {}, psycopg.OperationalError("the connection is lost"))

    with pytest.raises(DatabaseUnreachable, match=r"cannot be used: the connection is lost\."):
        once_available(database, lose, patience_s=1.0)
    assert len(tried) == REFUSALS


def test_a_database_whose_connections_are_all_in_use_says_so() -> None:
    folder = state_directory()
    with EmbeddedPostgres(folder, options=["max_connections=3", "superuser_reserved_connections=1"]) as postgres:
        database, held = Database(postgres.cluster.service_dsn()), list[psycopg.Connection]()
        with suppress(psycopg.OperationalError):
            while True:
                held.append(psycopg.connect(database.address))
        with pytest.raises(DatabaseUnreachable, match="has no free connection: run fewer processes"):
            once_available(database, lambda found: found.engine.connect().close(), patience_s=60.0)
        for connection in held:
            connection.close()
    shutil.rmtree(folder)


def test_place_of_a_silent_server_is_named_without_the_password() -> None:
    database = Database("postgresql://me:secret@127.0.0.1:9/none")
    with pytest.raises(DatabaseUnreachable, match=r"No database answers at 127\.0\.0\.1 port 9") as refusal:
        once_available(database, lambda _: None, patience_s=0.1)
    assert "secret" not in str(refusal.value)
