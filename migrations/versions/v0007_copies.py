"""Copies that an organizer has cleared, states of evaluations, and what archives are compared by.

Revision 0007, after 0006.
"""

import sqlalchemy as sa
from alembic import op

revision = "0007"
down_revision = "0006"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Add the columns and the table. Traces and archives from before have none of it, so nothing is compared there."""
    op.add_column("submissions", sa.Column("copy_cleared_at", sa.DateTime(timezone=True)))
    op.add_column("submissions", sa.Column("copy_cleared_for", sa.Text()))
    op.add_column("submissions", sa.Column("archive_sketch", sa.LargeBinary()))
    op.create_check_constraint(
        op.f("ck_submissions_copy_cleared_for_a_reason"),
        "submissions",
        "(copy_cleared_at IS NULL) = (copy_cleared_for IS NULL)",
    )
    op.add_column("action_traces", sa.Column("paths", sa.LargeBinary(), server_default="", nullable=False))
    op.create_table(
        "archive_copies",
        sa.Column("submission_id", sa.Uuid(), nullable=False),
        sa.Column("earlier_submission_id", sa.Uuid(), nullable=False),
        sa.Column("code", sa.Float()),
        sa.Column("weights", sa.Float()),
        sa.Column("found_at", sa.DateTime(timezone=True), server_default=sa.func.now(), nullable=False),
        sa.ForeignKeyConstraint(
            ["earlier_submission_id"],
            ["submissions.id"],
            name="fk_archive_copies_earlier_submission_id",
            ondelete="CASCADE",
        ),
        sa.ForeignKeyConstraint(
            ["submission_id"], ["submissions.id"], name="fk_archive_copies_submission_id", ondelete="CASCADE"
        ),
        sa.PrimaryKeyConstraint("submission_id", "earlier_submission_id", name="pk_archive_copies"),
    )


def downgrade() -> None:
    """Remove them, with all that was found and cleared."""
    op.drop_table("archive_copies")
    op.drop_column("action_traces", "paths")
    op.drop_constraint(op.f("ck_submissions_copy_cleared_for_a_reason"), "submissions")
    for column in ("archive_sketch", "copy_cleared_for", "copy_cleared_at"):
        op.drop_column("submissions", column)
