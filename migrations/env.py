"""Alembic's entry: runs the migrations on the connection that `vitac.server.database.schema` passes in."""

from alembic import context
from sqlalchemy import Connection, MetaData

NAMING = {
    "ix": "ix_%(table_name)s_%(column_0_N_name)s",
    "uq": "uq_%(table_name)s_%(column_0_N_name)s",
    "ck": "ck_%(table_name)s_%(constraint_name)s",
    "fk": "fk_%(table_name)s_%(column_0_name)s",
    "pk": "pk_%(table_name)s",
}
"""Names of what a migration does not name; later changes of the models' names do not change old migrations."""


def run(connection: Connection) -> None:
    """Run the wanted migrations, each in a transaction of its own."""
    names = MetaData(naming_convention=NAMING)
    context.configure(connection=connection, target_metadata=names, transaction_per_migration=True)
    with context.begin_transaction():
        context.run_migrations()


run(context.config.attributes["connection"])
