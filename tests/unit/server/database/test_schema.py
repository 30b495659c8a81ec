import shutil
import subprocess
import sys
import threading
from collections.abc import Iterator, Mapping
from enum import StrEnum
from importlib import import_module
from importlib.util import find_spec
from itertools import product
from pathlib import Path

import psycopg
import pytest
from alembic import command
from alembic.autogenerate import compare_metadata
from alembic.migration import MigrationContext
from alembic.script import ScriptDirectory
from databases import FAST, fresh_database, opened_database, shared_cluster, state_directory
from sqlalchemy import text
from sqlalchemy.exc import IntegrityError, OperationalError
from vitac.server.database import schema
from vitac.server.database.binaries import DEBIAN_ROOT, OLDEST_MAJOR, inspect_bin_dir
from vitac.server.database.embedded import EmbeddedPostgres
from vitac.server.database.engine import Database
from vitac.server.database.models import Base
from vitac.server.database.schema import (
    OtherSchema,
    WrongEncoding,
    explain_other_schema,
    installed_revision,
    knows_revision,
    newest_revision,
    upgrade,
)
from vitac.server.database.states import EVALUATION_TRANSITIONS, WORK_TRANSITIONS

OLDEST = DEBIAN_ROOT / str(OLDEST_MAJOR) / "bin"
CONSTRAINTS = """
    SELECT conrelid::regclass::text, conname, pg_get_constraintdef(oid) FROM pg_constraint
    WHERE connamespace = 'public'::regnamespace AND conrelid::regclass::text !~ '^alembic'
    AND contype <> 't' ORDER BY 1, 2
"""
INDEXES = """
    SELECT tablename, indexname, indexdef FROM pg_indexes
    WHERE schemaname = 'public' AND tablename !~ '^alembic' ORDER BY 1, 2
"""


@pytest.fixture
def migrated() -> Iterator[Database]:
    with opened_database() as database:
        yield database


@pytest.fixture
def empty() -> Iterator[Database]:
    with opened_database("template0") as database:
        yield database


def downgrade(database: Database, revision: str) -> None:
    with schema._migrating(database, 5.0, 60.0) as connection:
        command.downgrade(schema._configuration(connection), revision)


def is_current(database: Database) -> bool:
    with database.engine.connect() as connection:
        return installed_revision(connection) == newest_revision()


def rows(database: Database, query: str) -> list[tuple[object, ...]]:
    with database.engine.connect() as connection:
        return [tuple(row) for row in connection.execute(text(query))]


def test_columns_of_models_and_migrations_agree(migrated: Database) -> None:
    def ours(thing: object, name: str | None, kind: str, *_: object) -> bool:
        return not (kind == "table" and (name or "").startswith("alembic"))

    with migrated.engine.connect() as connection:
        options = {"include_object": ours, "compare_type": True, "compare_server_default": True}
        difference = compare_metadata(MigrationContext.configure(connection, opts=options), Base.metadata)
    assert difference == []


def test_constraints_and_indexes_of_models_and_migrations_agree(migrated: Database, empty: Database) -> None:
    Base.metadata.create_all(empty.engine)
    assert rows(migrated, CONSTRAINTS) == rows(empty, CONSTRAINTS)
    assert rows(migrated, INDEXES) == rows(empty, INDEXES)


def test_upgrade_of_an_empty_database_reaches_the_newest_revision_and_is_repeatable(empty: Database) -> None:
    assert not is_current(empty)
    upgrade(empty)
    upgrade(empty)
    assert is_current(empty)


def test_the_newest_revision_is_the_one_that_all_migrations_lead_to() -> None:
    folder = find_spec("vitac.migrations")
    assert folder is not None
    assert folder.origin is not None
    scripts = ScriptDirectory(str(Path(folder.origin).parent))
    assert scripts.get_heads() == [newest_revision()]
    revisions = {script.revision for script in scripts.walk_revisions()}
    assert {revision for revision in map("{:04}".format, range(10_000)) if knows_revision(revision)} == revisions


def test_each_revision_says_whether_older_processes_may_go_on() -> None:
    for path in schema._migrations().glob("versions/v*.py"):
        module = import_module(f"vitac.migrations.versions.{path.stem}")
        assert isinstance(module.works_with_older, bool), path.name


def test_a_process_works_with_a_newer_schema_that_only_adds_and_refuses_another(empty: Database) -> None:
    upgrade(empty)
    with empty.engine.begin() as connection:
        connection.exec_driver_sql("UPDATE alembic_version SET version_num = '9998'")
    upgrade(empty)
    with empty.engine.begin() as connection:
        assert explain_other_schema(connection) is None
        connection.exec_driver_sql("UPDATE schema_compatibility SET oldest = '9997'")
    with pytest.raises(OtherSchema) as refused:
        upgrade(empty)
    assert str(refused.value) == (
        f"The database has schema 9998, expected {newest_revision()}. Only releases from schema 9997 on work with it: "
        "start the newer release."
    )


def test_a_current_database_is_looked_at_without_alembic(migrated: Database) -> None:
    """A worker starts sooner without it."""
    looked = "from vitac.server.database import engine, schema; schema.upgrade(engine.Database(sys.argv[1]))"
    code = f"import sys; {looked}; sys.exit('alembic' in sys.modules)"
    subprocess.run([sys.executable, "-c", code, migrated.address], check=True)


def test_downgrade_takes_everything_back(empty: Database) -> None:
    upgrade(empty)
    downgrade(empty, "base")
    assert rows(empty, "SELECT tablename FROM pg_tables WHERE schemaname = 'public'") == [("alembic_version",)]
    assert rows(empty, "SELECT proname FROM pg_proc WHERE pronamespace = 'public'::regnamespace") == []
    upgrade(empty)
    with empty.engine.connect() as connection:
        assert installed_revision(connection) == newest_revision()


@pytest.mark.parametrize(
    ("limits", "refusal"),
    [
        ({"lock_timeout_s": 0.2}, "lock timeout"),
        ({"lock_timeout_s": 60.0, "statement_timeout_s": 0.5}, "statement timeout"),
    ],
)
def test_migration_that_waits_too_long_for_a_lock_is_rolled_back(
    empty: Database, limits: dict[str, float], refusal: str
) -> None:
    with psycopg.connect(empty.address) as blocker:
        blocker.execute("CREATE TABLE teams (id int)")  # until it ends, nobody else can make a table of that name
        with pytest.raises(OperationalError, match=refusal):
            upgrade(empty, **limits)
        blocker.rollback()
    with empty.engine.connect() as connection:
        assert installed_revision(connection) is None
    upgrade(empty)
    assert is_current(empty)


@pytest.mark.parametrize(
    ("table", "transitions"),
    [
        ("evaluations", EVALUATION_TRANSITIONS),
        ("work", WORK_TRANSITIONS),
    ],
)
def test_sql_allows_exactly_the_transitions_of_the_table(
    table: str, transitions: Mapping[StrEnum, frozenset[StrEnum]]
) -> None:
    allowed = {(old.value, new.value) for old, following in transitions.items() for new in following}
    with fresh_database() as address, psycopg.connect(address, autocommit=True) as connection:
        # The trigger alone, on a bare table of the same name: other constraints would hide what it lets through.
        connection.execute("CREATE SCHEMA bare")
        connection.execute(f"CREATE TABLE bare.{table} (id int, state text)")
        connection.execute(
            f"CREATE TRIGGER t BEFORE UPDATE OF state ON bare.{table} FOR EACH ROW "
            f"WHEN (OLD.state IS DISTINCT FROM NEW.state) EXECUTE FUNCTION public.check_{table}_transition()"
        )
        for old, new in product(transitions, repeat=2):
            connection.execute(f"TRUNCATE bare.{table}")
            connection.execute(f"INSERT INTO bare.{table} VALUES (1, %s)", [old.value])  # noqa: S608 - fixed table names
            try:
                connection.execute(f"UPDATE bare.{table} SET state = %s", [new.value])  # noqa: S608
                done = True
            except psycopg.errors.CheckViolation:
                done = False
            assert done == (old == new or (old.value, new.value) in allowed), (old, new)


def test_audit_log_refuses_change_and_deletion(migrated: Database) -> None:
    insert = "INSERT INTO audit_log (actor, action, subject, after) VALUES ('a', 'b', 'c', '{}')"
    with migrated.engine.begin() as connection:
        connection.execute(text(insert))
    for change in ("UPDATE audit_log SET actor = 'x'", "DELETE FROM audit_log", "TRUNCATE audit_log"):
        with pytest.raises(IntegrityError, match="append-only"), migrated.engine.begin() as connection:
            connection.execute(text(change))


def test_many_processes_may_upgrade_at_once(empty: Database) -> None:
    threads = [threading.Thread(target=upgrade, args=(empty,)) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert is_current(empty)
    assert rows(empty, "SELECT version_num FROM alembic_version") == [(newest_revision(),)]


@pytest.mark.skipif(inspect_bin_dir(OLDEST) is None, reason=f"no PostgreSQL in {OLDEST}")
def test_schema_works_on_the_oldest_supported_postgres() -> None:
    folder = state_directory()
    with EmbeddedPostgres(folder, bin_dir=OLDEST, options=FAST) as postgres:
        database = Database(postgres.cluster.dsn())
        upgrade(database)
        assert is_current(database)
        downgrade(database, "base")
        database.dispose()
    shutil.rmtree(folder)


def test_database_without_unicode_is_a_named_refusal() -> None:
    postgres = shared_cluster()
    with psycopg.connect(postgres.cluster.dsn("postgres"), autocommit=True) as connection:
        connection.execute("CREATE DATABASE bytes ENCODING 'SQL_ASCII' LOCALE 'C' TEMPLATE template0")
    database = Database(postgres.cluster.dsn("bytes"))
    with pytest.raises(WrongEncoding, match="Expected a database with the encoding UTF8, got SQL_ASCII"):
        upgrade(database)
    database.dispose()
