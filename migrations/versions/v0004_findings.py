"""Column for what the re-simulation of an uploaded log found against it."""

import sqlalchemy as sa
from alembic import op
from sqlalchemy.dialects import postgresql

revision = "0004"
down_revision = "0003"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Add the column; no shard that exists has a finding."""
    op.add_column(
        "shards", sa.Column("finding", postgresql.JSONB(none_as_null=True, astext_type=sa.Text()), nullable=True)
    )
    op.create_check_constraint(
        op.f("ck_shards_finding_is_a_failure"), "shards", "(finding IS NOT NULL) <= (state = 'failed')"
    )


def downgrade() -> None:
    """Remove the column."""
    op.drop_constraint(op.f("ck_shards_finding_is_a_failure"), "shards")
    op.drop_column("shards", "finding")
