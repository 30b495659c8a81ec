"""Keeps episodes that were played again with another record than the stored one, as alarms for the organizers."""

import sqlalchemy as sa
from alembic import op

revision = "0007"
down_revision = "0006"
branch_labels = None
depends_on = None

IS_SHA256 = "{column} ~ '^[0-9a-f]{{64}}$'"


def upgrade() -> None:
    """Add the table of alarms."""
    op.create_table(
        "episode_differences",
        sa.Column("id", sa.BigInteger(), sa.Identity(always=True), nullable=False),
        sa.Column("evaluation_id", sa.Uuid(), nullable=False),
        sa.Column("task", sa.Text(), nullable=False),
        sa.Column("episode", sa.Integer(), nullable=False),
        sa.Column("stored_digest", sa.String(64), nullable=False),
        sa.Column("differing_digest", sa.String(64), nullable=False),
        sa.Column("worker_id", sa.Uuid(), nullable=True),
        sa.Column("seen_at", sa.DateTime(timezone=True), server_default=sa.func.now(), nullable=False),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_episode_differences")),
        sa.ForeignKeyConstraint(
            ["evaluation_id"],
            ["evaluations.id"],
            name=op.f("fk_episode_differences_evaluation_id"),
            ondelete="CASCADE",
        ),
        sa.UniqueConstraint("evaluation_id", "task", "episode", "differing_digest", name="uq_episode_differences_key"),
        sa.CheckConstraint("stored_digest <> differing_digest", name=op.f("ck_episode_differences_records_differ")),
        *(
            sa.CheckConstraint(IS_SHA256.format(column=column), name=op.f(f"ck_episode_differences_{column}_is_sha256"))
            for column in ("stored_digest", "differing_digest")
        ),
    )


def downgrade() -> None:
    """Remove the table with its alarms."""
    op.drop_table("episode_differences")
