"""The boards of a competition as they were when it was finalized, for its archive."""

import sqlalchemy as sa
from alembic import op
from sqlalchemy.dialects import postgresql

revision = "0031"
down_revision = "0030"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Add the column; of a competition that is final already only the winners are kept."""
    op.add_column("competition", sa.Column("boards", postgresql.JSONB(), nullable=True))
    op.create_check_constraint(
        op.f("ck_competition_only_final_has_boards"), "competition", "boards IS NULL OR finalized_at IS NOT NULL"
    )


def downgrade() -> None:
    """Forget them."""
    op.drop_column("competition", "boards")
