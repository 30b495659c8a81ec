"""Rejudgements: evaluations beside the present results, which are applied or discarded together."""

import sqlalchemy as sa
from alembic import op

revision = "0029"
down_revision = "0028"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Add them; all evaluations until now are results of their submissions."""
    op.create_table(
        "rejudgements",
        sa.Column("id", sa.Uuid(), nullable=False),
        sa.Column("track", sa.Text(), nullable=False),
        sa.Column("stage", sa.Text(), nullable=False),
        sa.Column("reason", sa.Text(), nullable=False),
        sa.Column("started_at", sa.DateTime(timezone=True), server_default=sa.func.now(), nullable=False),
        sa.Column("applied_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("discarded_at", sa.DateTime(timezone=True), nullable=True),
        sa.CheckConstraint("applied_at IS NULL OR discarded_at IS NULL", name=op.f("ck_rejudgements_ends_in_one_way")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_rejudgements")),
    )
    op.add_column("evaluations", sa.Column("rejudgement_id", sa.Uuid(), nullable=True))
    op.add_column("evaluations", sa.Column("is_proposed", sa.Boolean(), server_default=sa.false(), nullable=False))
    op.create_foreign_key(
        op.f("fk_evaluations_rejudgement_id"),
        "evaluations",
        "rejudgements",
        ["rejudgement_id"],
        ["id"],
        ondelete="RESTRICT",
    )
    op.create_check_constraint(
        op.f("ck_evaluations_proposed_by_a_rejudgement"), "evaluations", "NOT is_proposed OR rejudgement_id IS NOT NULL"
    )
    op.create_index(
        op.f("ix_evaluations_rejudgement_id"),
        "evaluations",
        ["rejudgement_id"],
        postgresql_where=sa.text("rejudgement_id IS NOT NULL"),
    )


def downgrade() -> None:
    """Forget rejudgements with what was only proposed."""
    op.execute("DELETE FROM evaluations WHERE is_proposed")
    op.drop_index(op.f("ix_evaluations_rejudgement_id"), "evaluations")
    op.drop_column("evaluations", "is_proposed")
    op.drop_column("evaluations", "rejudgement_id")
    op.drop_table("rejudgements")
