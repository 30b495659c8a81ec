"""Column for the turn of an evaluation, by which teams share the workers."""

import sqlalchemy as sa
from alembic import op

revision = "0009"
down_revision = "0008"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Add the column; what waits already keeps its order, by age."""
    op.add_column("evaluations", sa.Column("turn", sa.Integer(), server_default=sa.text("0"), nullable=False))


def downgrade() -> None:
    """Remove the column."""
    op.drop_column("evaluations", "turn")
