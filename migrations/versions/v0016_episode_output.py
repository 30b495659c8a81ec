"""The end of what a policy prints in an episode is kept, beside the record."""

import sqlalchemy as sa
from alembic import op

revision = "0016"
down_revision = "0015"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Earlier episodes have none."""
    op.add_column("episode_results", sa.Column("output", sa.Text(), nullable=False, server_default=""))


def downgrade() -> None:
    """Forget what policies printed in episodes that ended well."""
    op.drop_column("episode_results", "output")
