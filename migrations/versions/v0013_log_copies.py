"""Logs whose states another team reached before: a digest of each episode's states, and what was found by it."""

import sqlalchemy as sa
from alembic import op

revision = "0013"
down_revision = "0012"
branch_labels = None
depends_on = None

IDS_AT_ONCE = 50_000
"""Records are large: one statement over all of them could run into the time limit of migrations."""

FILL = """
    UPDATE episode_results SET states_digest = coalesce((
        SELECT encode(sha256(convert_to(string_agg(hash, E'\\n' ORDER BY number), 'UTF8')), 'hex')
        FROM jsonb_array_elements_text(record -> 'state_hashes') WITH ORDINALITY AS states (hash, number)
    ), record_digest) WHERE id > :after AND id <= :up_to
"""
"""A record without states, which the evaluator never writes, is like no other one."""


def upgrade() -> None:
    """Add the digests, and the table of what was found; stored logs are compared when the next one is evaluated."""
    op.add_column("episode_results", sa.Column("states_digest", sa.String(length=64), nullable=True))
    fill_digests()
    op.alter_column("episode_results", "states_digest", nullable=False)
    op.create_index("ix_episode_results_states", "episode_results", ["states_digest", "task", "episode"])
    op.create_table(
        "log_copies",
        sa.Column("evaluation_id", sa.Uuid(), nullable=False),
        sa.Column("earlier_submission_id", sa.Uuid(), nullable=False),
        sa.Column("episodes", sa.Integer(), nullable=False),
        sa.Column("found_at", sa.DateTime(timezone=True), server_default=sa.func.now(), nullable=False),
        sa.CheckConstraint("episodes > 0", name=op.f("ck_log_copies_some_are_equal")),
        sa.ForeignKeyConstraint(
            ["evaluation_id"], ["evaluations.id"], name=op.f("fk_log_copies_evaluation_id"), ondelete="CASCADE"
        ),
        sa.ForeignKeyConstraint(
            ["earlier_submission_id"],
            ["submissions.id"],
            name=op.f("fk_log_copies_earlier_submission_id"),
            ondelete="CASCADE",
        ),
        sa.PrimaryKeyConstraint("evaluation_id", name=op.f("pk_log_copies")),
    )
    op.add_column("board_results", sa.Column("is_copy", sa.Boolean(), server_default=sa.false(), nullable=False))


def fill_digests() -> None:
    """Derive the digests of all stored records."""
    connection = op.get_bind()
    last = connection.scalar(sa.text("SELECT coalesce(max(id), 0) FROM episode_results"))
    for after in range(0, last, IDS_AT_ONCE):
        connection.execute(sa.text(FILL), {"after": after, "up_to": after + IDS_AT_ONCE})


def downgrade() -> None:
    """Remove it all; copies rank again."""
    op.drop_column("board_results", "is_copy")
    op.drop_table("log_copies")
    op.drop_index("ix_episode_results_states", "episode_results")
    op.drop_column("episode_results", "states_digest")
