"""Whether a team asked for an evaluation: only then machines that fail at it count as the team's."""

import sqlalchemy as sa
from alembic import op

revision = "0035"
down_revision = "0034"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Add the column; of older evaluations only those of a rejudgement are known to be the organizers'."""
    op.add_column("evaluations", sa.Column("asked_by_team", sa.Boolean, nullable=False, server_default=sa.true()))
    op.execute("UPDATE evaluations SET asked_by_team = false WHERE rejudgement_id IS NOT NULL")


def downgrade() -> None:
    """Count what organizers started, too."""
    op.drop_column("evaluations", "asked_by_team")
