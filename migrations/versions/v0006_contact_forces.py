"""Contact forces of episodes, beside the records, which take long to read.

Revision 0006, after 0005.
"""

import sqlalchemy as sa
from alembic import op
from sqlalchemy.dialects import postgresql

revision = "0006"
down_revision = "0005"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Add the column. Episodes from before have no forces."""
    op.add_column("episode_results", sa.Column("forces", postgresql.JSONB(none_as_null=True), nullable=True))


def downgrade() -> None:
    """Remove the column; the records still have the forces."""
    op.drop_column("episode_results", "forces")
