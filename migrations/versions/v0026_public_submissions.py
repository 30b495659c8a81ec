"""Submissions whose result everybody may see."""

import sqlalchemy as sa
from alembic import op

revision = "0026"
down_revision = "0025"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Keep all submissions as they were: their teams' own."""
    op.add_column("submissions", sa.Column("is_public", sa.Boolean(), nullable=False, server_default=sa.false()))


def downgrade() -> None:
    """Forget which ones are public."""
    op.drop_column("submissions", "is_public")
