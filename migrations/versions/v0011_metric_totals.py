"""Totals of what all processes count, and the workers' disks."""

import sqlalchemy as sa
from alembic import op

revision = "0011"
down_revision = "0010"
branch_labels = None
depends_on = None

DISK_COLUMNS = ("disk_bytes", "disk_free_bytes")


def upgrade() -> None:
    """Add the table and the columns; a worker fills them with its next heartbeat."""
    op.create_table(
        "metric_totals",
        sa.Column("name", sa.Text(), nullable=False),
        sa.Column("labels", sa.Text(), nullable=False),
        sa.Column("value", sa.Float(), nullable=False),
        sa.PrimaryKeyConstraint("name", "labels", name=op.f("pk_metric_totals")),
    )
    for column in DISK_COLUMNS:
        op.add_column("workers", sa.Column(column, sa.BigInteger(), nullable=True))


def downgrade() -> None:
    """Remove both."""
    for column in DISK_COLUMNS:
        op.drop_column("workers", column)
    op.drop_table("metric_totals")
