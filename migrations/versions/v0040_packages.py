"""Results keep which packages their policy could import."""

import sqlalchemy as sa
from alembic import op
from sqlalchemy.dialects import postgresql

revision = "0040"
down_revision = "0039"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Add the column; results that are there know of none."""
    op.add_column("evaluations", sa.Column("packages", postgresql.JSONB(), nullable=False, server_default="[]"))


def downgrade() -> None:
    """Remove it."""
    op.drop_column("evaluations", "packages")
