"""What an upgrade beside the old release needs: which releases the schema works with, and what becomes of evaluations.

Revision 0010, after 0009.
"""

import sqlalchemy as sa
from alembic import op

revision = "0010"
down_revision = "0009"
branch_labels = None
depends_on = None

works_with_older = False
"""Whether a process of the release before this revision may go on with the schema: it only adds what that one does not
need. From this revision on, each one says so."""


def upgrade() -> None:
    """Add both."""
    op.create_table(
        "schema_compatibility",
        sa.Column("oldest", sa.Text(), nullable=False),
        sa.PrimaryKeyConstraint("oldest", name="pk_schema_compatibility"),
    )
    op.add_column("declared_evaluators", sa.Column("outdated", sa.String(16), nullable=False, server_default="restart"))
    op.create_check_constraint(
        op.f("ck_declared_evaluators_outdated"), "declared_evaluators", "outdated IN ('restart', 'finish')"
    )


def downgrade() -> None:
    """Remove both."""
    op.drop_column("declared_evaluators", "outdated")
    op.drop_table("schema_compatibility")
