"""Marks of judges, and their conflicts of interest."""

import sqlalchemy as sa
from alembic import op

revision = "0033"
down_revision = "0032"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Add the tables."""
    op.create_table(
        "judging_marks",
        sa.Column("submission_id", sa.Uuid(), nullable=False),
        sa.Column("judge", sa.Text(), nullable=False),
        sa.Column("criterion", sa.Text(), nullable=False),
        sa.Column("mark", sa.Float(), nullable=False),
        sa.Column("given_at", sa.DateTime(timezone=True), server_default=sa.func.now(), nullable=False),
        sa.CheckConstraint("mark >= 0 AND mark <= 10", name=op.f("ck_judging_marks_mark_is_in_range")),
        sa.ForeignKeyConstraint(
            ["submission_id"], ["submissions.id"], name=op.f("fk_judging_marks_submission_id"), ondelete="CASCADE"
        ),
        sa.PrimaryKeyConstraint("submission_id", "judge", "criterion", name=op.f("pk_judging_marks")),
    )
    op.create_table(
        "judging_conflicts",
        sa.Column("team_id", sa.Uuid(), nullable=False),
        sa.Column("judge", sa.Text(), nullable=False),
        sa.Column("reason", sa.Text(), nullable=False),
        sa.Column("declared_at", sa.DateTime(timezone=True), server_default=sa.func.now(), nullable=False),
        sa.ForeignKeyConstraint(
            ["team_id"], ["teams.id"], name=op.f("fk_judging_conflicts_team_id"), ondelete="CASCADE"
        ),
        sa.PrimaryKeyConstraint("team_id", "judge", name=op.f("pk_judging_conflicts")),
    )


def downgrade() -> None:
    """Forget both."""
    for table in ("judging_conflicts", "judging_marks"):
        op.drop_table(table)
