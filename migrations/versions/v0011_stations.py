"""Stations: laboratories whose agents play trials, each with a key.

Revision 0011, after 0010.
"""

import sqlalchemy as sa
from alembic import op

revision = "0011"
down_revision = "0010"
branch_labels = None
depends_on = None

works_with_older = True


def upgrade() -> None:
    """Add the table, without a station."""
    op.create_table(
        "stations",
        sa.Column("name", sa.Text(), nullable=False),
        sa.Column("key_sha256", sa.Text(), nullable=False),
        sa.Column("worker_id", sa.Uuid(), nullable=True),
        sa.Column("created_at", sa.DateTime(timezone=True), server_default=sa.text("now()"), nullable=False),
        sa.PrimaryKeyConstraint("name", name="pk_stations"),
        sa.UniqueConstraint("key_sha256", name="uq_stations_key_sha256"),
    )


def downgrade() -> None:
    """Remove it; keys of stations are lost."""
    op.drop_table("stations")
