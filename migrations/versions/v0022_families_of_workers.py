"""A worker says of which families of environments it can run the tasks."""

import sqlalchemy as sa
from alembic import op
from sqlalchemy.dialects.postgresql import ARRAY

revision = "0022"
down_revision = "0021"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Earlier workers know the tactile tasks only."""
    op.add_column("workers", sa.Column("families", ARRAY(sa.Text()), nullable=False, server_default="{tactile}"))


def downgrade() -> None:
    """Forget what workers can run."""
    op.drop_column("workers", "families")
