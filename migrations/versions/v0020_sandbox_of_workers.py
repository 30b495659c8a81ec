"""Workers say what a policy finds in their sandbox."""

import sqlalchemy as sa
from alembic import op
from sqlalchemy.dialects import postgresql

revision = "0020"
down_revision = "0019"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Add the column; workers fill it when they start."""
    op.add_column("workers", sa.Column("sandbox", postgresql.JSONB(), nullable=True))


def downgrade() -> None:
    """Remove it."""
    op.drop_column("workers", "sandbox")
