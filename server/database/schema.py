"""Brings a database to the schema of this version; called by server, worker and CLI at their start.

Alembic is imported only where there is something to migrate: every start would pay for it and for all migrations.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from psycopg import sql
from psycopg.conninfo import conninfo_to_dict
from sqlalchemy import Connection, NullPool, create_engine, text
from vitac.errors import VitacError

from .engine import ENCODING, Database, sqlalchemy_url
from .locks import AdvisoryLock, wait_for_lock

if TYPE_CHECKING:
    from alembic.config import Config

APPEND_ONLY = ("audit_log", "receipts", "tree_nodes", "cosignatures")


class NotTheOwner(VitacError):
    """The schema is to be migrated by the owner of the tables; name it in VITAC_DATABASE_OWNER_URL."""


def service_role(address: str) -> str:
    """Return the role of an address."""
    return str(conninfo_to_dict(address)["user"])


def require_owner(connection: Connection) -> None:
    """Refuse to migrate as a role that cannot make tables.

    Raises:
        NotTheOwner: the role of the connection cannot.
    """
    if not connection.scalar(text("SELECT has_schema_privilege('public', 'CREATE')")):
        role = connection.scalar(text("SELECT current_user"))
        raise NotTheOwner(
            f"The schema is to be migrated, and the role {role} cannot make tables. Name the address of their owner in "
            "VITAC_DATABASE_OWNER_URL, or start a server that has it first."
        )


def let_service_work(connection: Connection, role: str, *, tables_are_new: bool) -> None:
    """Let a role read and write all tables, but only add to those that grow; do nothing where it may already."""
    may = connection.scalar(text("SELECT has_table_privilege(:role, 'audit_log', 'INSERT')"), {"role": role})
    if may and not tables_are_new:
        return
    for statement in (
        "GRANT USAGE ON SCHEMA public TO {}",
        "GRANT SELECT, INSERT, UPDATE, DELETE ON ALL TABLES IN SCHEMA public TO {}",
        "GRANT SELECT, USAGE ON ALL SEQUENCES IN SCHEMA public TO {}",
        "REVOKE INSERT, UPDATE, DELETE ON alembic_version, schema_compatibility FROM {}",
        *(f"REVOKE UPDATE, DELETE ON {table} FROM {{}}" for table in APPEND_ONLY),
    ):
        connection.exec_driver_sql(sql.SQL(statement).format(sql.Identifier(role)).as_string())
    connection.commit()


class WrongEncoding(VitacError):
    """The database does not hold text as UTF-8; make another one."""


class OtherSchema(VitacError):
    """A newer release has changed the schema so that this one cannot work with it; start that release."""


LOCK_TIMEOUT_S = 5.0
"""A migration that cannot get its table lock fails instead of stopping all other work behind it."""


STATEMENT_TIMEOUT_S = 300.0
"""A statement of a migration that runs longer is ended and rolled back: whoever migrates holds the upgrade lock, and
every process that starts waits for it. Rewrite more rows than that in batches, outside a migration."""


def upgrade(
    database: Database, *, lock_timeout_s: float = LOCK_TIMEOUT_S, statement_timeout_s: float = STATEMENT_TIMEOUT_S
) -> None:
    """Run all migrations that are missing, each in a transaction of its own; do nothing on a current database.

    The owner of the tables runs them and lets the service's role work with what they made.

    Raises:
        WrongEncoding: the database does not hold text as UTF-8.
        OtherSchema: a newer release has changed the schema, and this one cannot work with it.
        NotTheOwner: something is to be migrated, and this process does not have the owner's address.
        sqlalchemy.exc.OperationalError: another transaction held a table for longer than `lock_timeout_s`, or a
            statement took longer than `statement_timeout_s`.
    """
    with _migrating(database, lock_timeout_s, statement_timeout_s) as connection:
        _require_utf8(connection)
        installed = installed_revision(connection)
        is_old = installed is None or (knows_revision(installed) and installed != newest_revision())
        if is_old:
            from alembic import command

            require_owner(connection)
            connection.rollback()
            command.upgrade(_configuration(connection), "head")
            _note_oldest(connection)
        elif problem := explain_other_schema(connection):
            raise OtherSchema(problem)
        if database.owner_address != database.address:
            let_service_work(connection, service_role(database.address), tables_are_new=is_old)


def _require_utf8(connection: Connection) -> None:
    encoding = connection.exec_driver_sql("SHOW server_encoding").scalar_one()
    if encoding != "UTF8":
        raise WrongEncoding(
            f"Expected a database with the encoding UTF8, got {encoding}. Make one with "
            "`CREATE DATABASE ... ENCODING 'UTF8' TEMPLATE template0` and name it in VITAC_DATABASE_URL."
        )


@contextmanager
def _migrating(database: Database, lock_timeout_s: float, statement_timeout_s: float) -> Iterator[Connection]:
    """Return a connection of its own, closed afterwards, that alone may change the schema."""
    engine = create_engine(sqlalchemy_url(database.owner_address), poolclass=NullPool, connect_args=ENCODING)
    with engine.connect() as connection:
        # For the session, not for a transaction: the migrations have one each. The limits hold from here on only, for
        # waiting for another process that migrates is no fault.
        wait_for_lock(connection, AdvisoryLock.SCHEMA_UPGRADE)
        connection.exec_driver_sql(f"SET lock_timeout = {round(1000 * lock_timeout_s)}")
        connection.exec_driver_sql(f"SET statement_timeout = {round(1000 * statement_timeout_s)}")
        connection.commit()
        yield connection


def explain_other_schema(connection: Connection) -> str | None:
    """Return why this release cannot work with the schema; None where it can, as with what a newer one only added."""
    installed, own = installed_revision(connection), newest_revision()
    if installed == own:
        return None
    advice = "Start the release that has it."
    if installed is not None and installed > own:
        oldest = connection.exec_driver_sql("SELECT max(oldest) FROM schema_compatibility").scalar_one()
        if oldest is not None and oldest <= own:
            return None
        advice = f"Only releases from schema {oldest} on work with it: start the newer release."
    return f"The database has schema {installed or 'none'}, expected {own}. {advice}"


def _note_oldest(connection: Connection) -> None:
    """Store which releases work with the schema: those since the last revision that did more than add."""
    versions = _migrations() / "versions"
    oldest = max(
        path.name[1:5]
        for path in versions.glob("v*.py")
        if not import_module(f"vitac.migrations.versions.{path.stem}").works_with_older
    )
    connection.exec_driver_sql("DELETE FROM schema_compatibility")
    connection.exec_driver_sql("INSERT INTO schema_compatibility VALUES (%s)", (oldest,))
    connection.commit()


def installed_revision(connection: Connection) -> str | None:
    """Return the revision that the database has; None when it is empty."""
    if connection.exec_driver_sql("SELECT to_regclass('alembic_version')").scalar_one() is None:
        return None
    revision: str | None = connection.exec_driver_sql("SELECT version_num FROM alembic_version").scalar_one_or_none()
    return revision


def newest_revision() -> str:
    """Return the revision of this version."""
    return max(_revisions())


def knows_revision(revision: str) -> bool:
    """Return whether a revision is one of this version's migrations, so that `upgrade` can start from it."""
    return revision in _revisions()


@cache
def _revisions() -> frozenset[str]:
    """Return those of all migrations, by the names of their modules: `v0016_first_schema` is 0016."""
    matches = (re.fullmatch(r"v(\d{4})_\w+\.py", path.name) for path in (_migrations() / "versions").iterdir())
    return frozenset(match[1] for match in matches if match is not None)


def _migrations() -> Path:
    spec = find_spec("vitac.migrations")
    if spec is None or spec.origin is None:
        raise ModuleNotFoundError("The package vitac.migrations is not installed; install vitac-arena again.")
    return Path(spec.origin).parent


def _configuration(connection: Connection) -> Config:
    from alembic.config import Config

    configuration = Config()
    configuration.set_main_option("script_location", str(_migrations()).replace("%", "%%"))
    configuration.attributes["connection"] = connection
    return configuration
