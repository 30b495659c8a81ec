"""What teams write about their public results, and what a model's archive holds.

Revision 0009, after 0008.
"""

import sqlalchemy as sa
from alembic import op
from sqlalchemy.dialects.postgresql import JSONB

revision = "0009"
down_revision = "0008"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Add the columns; of archives from before nothing is known."""
    op.add_column("submissions", sa.Column("description", JSONB()))
    op.add_column("submissions", sa.Column("description_removed_for", sa.Text()))
    op.add_column("submissions", sa.Column("contents", JSONB()))


def downgrade() -> None:
    """Remove them, with all that teams wrote."""
    for column in ("contents", "description_removed_for", "description"):
        op.drop_column("submissions", column)
