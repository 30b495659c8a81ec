"""Alembic's entry: runs the migrations on the connection that `vitac.server.db.schema` passes in."""

from alembic import context
from sqlalchemy import Connection


def run(connection: Connection) -> None:
    """Run the wanted migrations, each in a transaction of its own."""
    context.configure(connection=connection, transaction_per_migration=True)
    with context.begin_transaction():
        context.run_migrations()


run(context.config.attributes["connection"])
