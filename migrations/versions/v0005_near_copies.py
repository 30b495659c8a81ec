"""Actions of evaluations, by which near copies are found, and what was found.

Revision 0005, after 0004.
"""

import sqlalchemy as sa
from alembic import op

revision = "0005"
down_revision = "0004"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Make the tables. Evaluations from before have no trace, so nothing is compared with them."""
    op.create_table(
        "action_traces",
        sa.Column("evaluation_id", sa.Uuid(), nullable=False),
        sa.Column("task", sa.Text(), nullable=False),
        sa.Column("commitment", sa.Text(), nullable=False),
        sa.Column("action_size", sa.Integer(), nullable=False),
        sa.Column("actions", sa.LargeBinary(), nullable=False),
        sa.ForeignKeyConstraint(
            ["evaluation_id"], ["evaluations.id"], name="fk_action_traces_evaluation_id", ondelete="CASCADE"
        ),
        sa.PrimaryKeyConstraint("evaluation_id", "task", "commitment", name="pk_action_traces"),
    )
    op.create_index("ix_action_traces_task_commitment", "action_traces", ["task", "commitment"])
    op.create_table(
        "near_copies",
        sa.Column("evaluation_id", sa.Uuid(), nullable=False),
        sa.Column("earlier_submission_id", sa.Uuid(), nullable=False),
        sa.Column("task", sa.Text(), nullable=False),
        sa.Column("commitment", sa.Text(), nullable=False),
        sa.Column("near", sa.Integer(), nullable=False),
        sa.Column("episodes", sa.Integer(), nullable=False),
        sa.Column("difference", sa.Float(), nullable=False),
        sa.Column("found_at", sa.DateTime(timezone=True), server_default=sa.func.now(), nullable=False),
        sa.CheckConstraint("near > 0 AND near <= episodes", name=op.f("ck_near_copies_some_are_near")),
        sa.ForeignKeyConstraint(
            ["earlier_submission_id"],
            ["submissions.id"],
            name="fk_near_copies_earlier_submission_id",
            ondelete="CASCADE",
        ),
        sa.ForeignKeyConstraint(
            ["evaluation_id"], ["evaluations.id"], name="fk_near_copies_evaluation_id", ondelete="CASCADE"
        ),
        sa.PrimaryKeyConstraint("evaluation_id", "earlier_submission_id", "task", "commitment", name="pk_near_copies"),
    )


def downgrade() -> None:
    """Remove the tables, with all that was found."""
    op.drop_table("near_copies")
    op.drop_table("action_traces")
