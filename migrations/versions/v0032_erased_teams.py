"""Teams that were removed, of which only scores are left."""

import sqlalchemy as sa
from alembic import op

revision = "0032"
down_revision = "0031"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """No team from before was removed."""
    op.add_column("teams", sa.Column("erased_at", sa.DateTime(timezone=True), nullable=True))


def downgrade() -> None:
    """Forget when it was; what was removed does not come back."""
    op.drop_column("teams", "erased_at")
