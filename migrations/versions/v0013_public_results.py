"""An index by which the newest completed evaluations are found, whose stills are looked after.

Revision 0013, after 0012.
"""

import sqlalchemy as sa
from alembic import op

revision = "0013"
down_revision = "0012"
branch_labels = None
depends_on = None

works_with_older = True

INDEX = "ix_evaluations_completed_finished_at"


def upgrade() -> None:
    """Add it."""
    op.create_index(INDEX, "evaluations", ["finished_at"], postgresql_where=sa.text("state = 'completed'"))


def downgrade() -> None:
    """Remove it."""
    op.drop_index(INDEX, "evaluations")
