"""Announcements, questions, appeals."""

import sqlalchemy as sa
from alembic import op

revision = "0028"
down_revision = "0027"
branch_labels = None
depends_on = None

MOMENT = sa.DateTime(timezone=True)


def upgrade() -> None:
    """Add the tables."""
    op.create_table(
        "announcements",
        sa.Column("id", sa.Integer(), nullable=False),
        sa.Column("title", sa.String(length=120), nullable=False),
        sa.Column("text", sa.Text(), nullable=False),
        sa.Column("published_at", MOMENT, server_default=sa.func.now(), nullable=False),
        sa.Column("withdrawn_at", MOMENT, nullable=True),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_announcements")),
    )
    op.create_table(
        "questions",
        sa.Column("id", sa.Integer(), nullable=False),
        sa.Column("team_id", sa.Uuid(), nullable=True),
        sa.Column("text", sa.Text(), nullable=False),
        sa.Column("public", sa.Boolean(), nullable=False),
        sa.Column("asked_at", MOMENT, server_default=sa.func.now(), nullable=False),
        sa.Column("answer", sa.Text(), nullable=True),
        sa.Column("answered_at", MOMENT, nullable=True),
        sa.Column("hidden_at", MOMENT, nullable=True),
        sa.CheckConstraint("(answer IS NULL) = (answered_at IS NULL)", name=op.f("ck_questions_answer_has_a_time")),
        sa.ForeignKeyConstraint(["team_id"], ["teams.id"], name=op.f("fk_questions_team_id"), ondelete="SET NULL"),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_questions")),
    )
    op.create_index(op.f("ix_questions_team_id"), "questions", ["team_id"])
    _add_appeals()


def downgrade() -> None:
    """Forget all that was said."""
    for table in ("appeal_replays", "appeals", "questions", "announcements"):
        op.drop_table(table)


def _add_appeals() -> None:
    states = ("open", "upheld", "rejected", "withdrawn")
    op.create_table(
        "appeals",
        sa.Column("id", sa.Integer(), nullable=False),
        sa.Column("team_id", sa.Uuid(), nullable=False),
        sa.Column("evaluation_id", sa.Uuid(), nullable=False),
        sa.Column("task", sa.Text(), nullable=True),
        sa.Column("episode", sa.Integer(), nullable=True),
        sa.Column("text", sa.Text(), nullable=False),
        sa.Column("state", sa.String(length=16), nullable=False),
        sa.Column("opened_at", MOMENT, server_default=sa.func.now(), nullable=False),
        sa.Column("ended_at", MOMENT, nullable=True),
        sa.Column("ruling", sa.Text(), nullable=True),
        sa.CheckConstraint(f"state IN ({', '.join(map(repr, states))})", name=op.f("ck_appeals_state")),
        sa.CheckConstraint("(task IS NULL) = (episode IS NULL)", name=op.f("ck_appeals_episodes_have_a_task")),
        sa.CheckConstraint("(state = 'open') = (ended_at IS NULL)", name=op.f("ck_appeals_ended_has_a_time")),
        sa.CheckConstraint(
            "(state IN ('upheld', 'rejected')) = (ruling IS NOT NULL)", name=op.f("ck_appeals_ruled_on_has_a_ruling")
        ),
        sa.ForeignKeyConstraint(["team_id"], ["teams.id"], name=op.f("fk_appeals_team_id"), ondelete="CASCADE"),
        sa.ForeignKeyConstraint(
            ["evaluation_id"], ["evaluations.id"], name=op.f("fk_appeals_evaluation_id"), ondelete="CASCADE"
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_appeals")),
    )
    op.create_index(op.f("ix_appeals_team_id"), "appeals", ["team_id"])
    op.create_index(
        "uq_appeals_open", "appeals", ["evaluation_id"], unique=True, postgresql_where=sa.text("state = 'open'")
    )
    op.create_table(
        "appeal_replays",
        sa.Column("id", sa.Integer(), nullable=False),
        sa.Column("appeal_id", sa.Integer(), nullable=False),
        sa.Column("task", sa.Text(), nullable=False),
        sa.Column("episode", sa.Integer(), nullable=False),
        sa.Column("policy_sha256", sa.String(length=64), nullable=False),
        sa.Column("corrected", sa.Boolean(), nullable=False),
        sa.Column("outcome", sa.Text(), nullable=False),
        sa.Column("env_steps", sa.Integer(), nullable=False),
        sa.Column("same_states", sa.Boolean(), nullable=False),
        sa.Column("old_outcome", sa.Text(), nullable=False),
        sa.Column("old_env_steps", sa.Integer(), nullable=False),
        sa.Column("played_at", MOMENT, server_default=sa.func.now(), nullable=False),
        sa.CheckConstraint("policy_sha256 ~ '^[0-9a-f]{64}$'", name=op.f("ck_appeal_replays_policy_sha256_is_sha256")),
        sa.ForeignKeyConstraint(
            ["appeal_id"], ["appeals.id"], name=op.f("fk_appeal_replays_appeal_id"), ondelete="CASCADE"
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_appeal_replays")),
    )
    op.create_index(op.f("ix_appeal_replays_appeal_id"), "appeal_replays", ["appeal_id"])
