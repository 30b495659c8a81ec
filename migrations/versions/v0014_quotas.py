"""Limits of single teams, and which evaluations count towards them."""

import sqlalchemy as sa
from alembic import op

revision = "0014"
down_revision = "0013"
branch_labels = None
depends_on = None

QUOTAS = "'scored_runs_per_day', 'attempts_per_day', 'queued_at_once', 'tokens', 'event_streams'"


def upgrade() -> None:
    """Add table and column; evaluations from before count towards nothing."""
    op.create_table(
        "team_quotas",
        sa.Column("team_id", sa.Uuid(), nullable=False),
        sa.Column("quota", sa.String(length=32), nullable=False),
        sa.Column("most", sa.Integer(), nullable=True),
        sa.CheckConstraint("most >= 0", name=op.f("ck_team_quotas_is_a_number")),
        sa.CheckConstraint(f"quota IN ({QUOTAS})", name=op.f("ck_team_quotas_quota")),
        sa.ForeignKeyConstraint(["team_id"], ["teams.id"], name=op.f("fk_team_quotas_team_id"), ondelete="CASCADE"),
        sa.PrimaryKeyConstraint("team_id", "quota", name=op.f("pk_team_quotas")),
    )
    op.add_column("evaluations", sa.Column("charged_at", sa.DateTime(timezone=True), nullable=True))
    op.create_index(
        "ix_evaluations_charged_at",
        "evaluations",
        ["charged_at"],
        postgresql_where=sa.text("charged_at IS NOT NULL"),
    )


def downgrade() -> None:
    """Remove both."""
    op.drop_column("evaluations", "charged_at")
    op.drop_table("team_quotas")
