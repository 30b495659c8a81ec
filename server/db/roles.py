"""What the service's role may do with tables that another role owns; called where the schema is migrated.

An owner can lift every trigger of its tables, and a superuser all triggers at once. The role of the service can do
neither: it adds lines to the audit log and to the log of receipts, and cannot change or remove them.
"""

from psycopg import sql
from psycopg.conninfo import conninfo_to_dict
from sqlalchemy import Connection, text
from vitac.envs.errors import VitacError

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
