"""Receipts say of which board they are, so that none can be left out of an export of it unseen."""

import sqlalchemy as sa
from alembic import op

revision = "0037"
down_revision = "0036"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Add the board; receipts from before are signed without one, so theirs stays unknown."""
    op.add_column("receipts", sa.Column("board", sa.Text(), nullable=True))
    op.create_index("ix_receipts_board", "receipts", ["board"])


def downgrade() -> None:
    """Forget it: the signatures of receipts that name a board no longer match."""
    op.drop_index("ix_receipts_board", "receipts")
    op.drop_column("receipts", "board")
