"""Why each shard was queued again.

Revision 0015, after 0013.
"""

import sqlalchemy as sa
from alembic import op
from sqlalchemy.dialects.postgresql import JSONB

revision = "0015"
down_revision = "0013"
branch_labels = None
depends_on = None

works_with_older = True


def upgrade() -> None:
    """Add the column, empty for shards of before."""
    op.add_column("shards", sa.Column("repeats", JSONB(), server_default="[]", nullable=False))


def downgrade() -> None:
    """Remove it."""
    op.drop_column("shards", "repeats")
