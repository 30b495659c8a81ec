"""The service works as a role that owns no table, and what only grows it can neither change nor empty."""

import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from databases import administration, fresh_database, state_directory
from psycopg import sql
from psycopg.conninfo import conninfo_to_dict
from service_factories import make_principal, make_settings, play_all, submit
from sqlalchemy import make_url, select, text
from sqlalchemy.exc import DBAPIError
from vitac.server.database.cluster import DATABASE
from vitac.server.database.engine import Database
from vitac.server.database.models import AuditEntry, ReceiptRow
from vitac.server.database.schema import NotTheOwner, upgrade
from vitac.server.operations.backup import back_up, restore
from vitac.server.services import Services, open_services
from vitac.server.settings import Settings
from vitac.server.storage.blobs import BlobStore


@pytest.fixture
def role() -> Iterator[str]:
    """The name, and the password, of a role that owns nothing."""
    name = f"service_{secrets.token_hex(6)}"
    make = sql.SQL("CREATE ROLE {} LOGIN PASSWORD {}").format(sql.Identifier(name), sql.Literal(name))
    administration().execute(make)
    yield name
    administration().execute(sql.SQL("DROP ROLE {}").format(sql.Identifier(name)))


@contextmanager
def worked_on_by(role: str, template: str | None = None) -> Iterator[Database]:
    """A database of another owner as the role's service has it; without a template an empty one."""
    with fresh_database(*([template] if template else [])) as owner_address:
        address = make_url(owner_address).set(username=role, password=role).render_as_string(hide_password=False)
        database = Database(address, owner_address=owner_address)
        yield database
        database.dispose()


@pytest.fixture
def database(role: str) -> Iterator[Database]:
    with worked_on_by(role) as database:
        upgrade(database)
        yield database


def finish_one(database: Database) -> None:
    with database.transaction() as session:
        submission = submit(session, make_principal(session))
    play_all(database, submission)


REFUSED = (
    "SET session_replication_role = replica",
    "UPDATE audit_log SET action = 'nothing'",
    "DELETE FROM audit_log",
    "DELETE FROM receipts",
    "TRUNCATE audit_log",
    "ALTER TABLE audit_log DISABLE TRIGGER ALL",
    "DROP TRIGGER audit_log_append_only ON audit_log",
    "CREATE OR REPLACE FUNCTION refuse_change() RETURNS trigger LANGUAGE plpgsql AS 'BEGIN RETURN NEW; END'",
    "DROP TABLE audit_log",
    "ALTER TABLE receipts OWNER TO CURRENT_USER",
    "UPDATE alembic_version SET version_num = '0'",
    "CREATE TABLE other (id int)",
)


def test_the_service_evaluates_and_cannot_change_what_only_grows(database: Database) -> None:
    finish_one(database)
    for statement in REFUSED:
        refused = pytest.raises(DBAPIError, match=r"permission denied|must be owner")
        with refused, database.transaction() as session:
            session.execute(text(statement))
    with database.transaction() as session:
        assert len(session.scalars(select(ReceiptRow)).all()) == 2
        assert session.scalars(select(AuditEntry)).all() != []


def test_a_second_start_and_one_without_the_owners_address_do_nothing(database: Database) -> None:
    upgrade(database)
    upgrade(Database(database.address))
    finish_one(database)


def test_a_schema_is_not_migrated_by_a_role_that_owns_nothing(role: str) -> None:
    with worked_on_by(role, "template0") as empty:
        with pytest.raises(NotTheOwner, match="VITAC_DATABASE_OWNER_URL"):
            upgrade(Database(empty.address))
        upgrade(empty)
        finish_one(empty)


def get_services(settings: Settings, database: Database) -> Services:
    settings.scratch_dir.mkdir(parents=True)
    return Services(settings=settings, database=database, blobs=BlobStore.from_settings(settings), postgres=None)


def test_a_backup_of_the_service_is_restored_and_its_role_works_again(
    database: Database, role: str, tmp_path: Path
) -> None:
    with database.transaction() as session:
        make_principal(session)
    file = tmp_path / "backup.vitac"
    back_up(get_services(make_settings(state_dir=tmp_path / "old"), database), file)
    with worked_on_by(role) as other:
        upgrade(other)
        restored = get_services(make_settings(state_dir=tmp_path / "new"), other)
        restore(restored, file)
        with other.transaction() as session:
            submit(session, make_principal(session, "Bees"))
        with pytest.raises(DBAPIError, match="permission denied"), other.transaction() as session:
            session.execute(text("DELETE FROM audit_log"))


def test_the_embedded_database_is_worked_on_by_a_role_that_owns_nothing() -> None:
    with open_services(Settings(state_dir=state_directory())) as services:
        assert conninfo_to_dict(services.database.address)["dbname"] == DATABASE
        with services.database.transaction() as session:
            assert session.scalar(text("SELECT current_setting('is_superuser')")) == "off"
            assert session.scalar(text("SELECT count(*) FROM pg_tables WHERE tableowner = current_user")) == 0
        finish_one(services.database)
        with pytest.raises(DBAPIError, match="permission denied"), services.database.transaction() as session:
            session.execute(text("SET LOCAL session_replication_role = replica"))
