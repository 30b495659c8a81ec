"""Names of files that arrive in pieces, which are checked when all is there."""

import sqlalchemy as sa
from alembic import op

revision = "0030"
down_revision = "0029"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Add the column; of uploads until now no name is known."""
    op.add_column("partial_uploads", sa.Column("file_name", sa.Text(), nullable=True))


def downgrade() -> None:
    """Forget them."""
    op.drop_column("partial_uploads", "file_name")
