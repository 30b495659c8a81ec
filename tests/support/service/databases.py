"""One embedded PostgreSQL per test run and a fresh migrated database per test; imported by tests that need it."""

import atexit
import os
import secrets
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path

import psycopg
from vitac.server.db.engine import Database
from vitac.server.db.schema import upgrade
from vitac.server.postgres.embedded import EmbeddedPostgres

TEMPLATE = "vitac_template"
FAST = ("fsync=off", "synchronous_commit=off", "full_page_writes=off")


def state_directory() -> Path:
    """A new folder that the database's user can reach also when the tests run as root; pytest's own let nobody in."""
    folder = Path(tempfile.mkdtemp(prefix="vitac-test-", dir="/tmp"))
    folder.chmod(0o711 if os.geteuid() == 0 else 0o700)
    return folder


@cache
def shared_cluster() -> EmbeddedPostgres:
    """The cluster of this test run, with a migrated template database; ended when the run ends."""
    folder = state_directory()
    postgres = EmbeddedPostgres(folder, options=FAST)
    postgres.start()

    def end() -> None:
        postgres.stop()
        shutil.rmtree(folder, ignore_errors=True)

    atexit.register(end)
    with psycopg.connect(postgres.cluster.dsn("postgres"), autocommit=True) as connection:
        connection.execute(f"CREATE DATABASE {TEMPLATE}")
    template = Database(postgres.cluster.dsn(TEMPLATE))
    upgrade(template)
    template.dispose()
    return postgres


@contextmanager
def fresh_database(template: str = TEMPLATE) -> Iterator[str]:
    """Address of a new database, a copy of the migrated template; dropped afterwards, whoever is connected."""
    postgres = shared_cluster()
    name = f"t_{secrets.token_hex(6)}"
    with psycopg.connect(postgres.cluster.dsn("postgres"), autocommit=True) as connection:
        connection.execute(f"CREATE DATABASE {name} TEMPLATE {template} STRATEGY file_copy")
        try:
            yield postgres.cluster.dsn(name)
        finally:
            connection.execute(f"DROP DATABASE {name} WITH (FORCE)")
