"""The trace of the request that an evaluation began in.

Revision 0012, after 0011.
"""

import sqlalchemy as sa
from alembic import op

revision = "0012"
down_revision = "0011"
branch_labels = None
depends_on = None

works_with_older = True


def upgrade() -> None:
    """Add the column."""
    op.add_column("evaluations", sa.Column("traceparent", sa.Text()))


def downgrade() -> None:
    """Remove it."""
    op.drop_column("evaluations", "traceparent")
