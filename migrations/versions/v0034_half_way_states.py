"""The state half-way through each episode, by which a log is found that repeats the beginnings of another team's."""

import sqlalchemy as sa
from alembic import op

revision = "0034"
down_revision = "0033"
branch_labels = None
depends_on = None

IDS_AT_ONCE = 50_000
"""Records are large: one statement over all of them could run into the time limit of migrations."""

FILL = """
    UPDATE episode_results
    SET half_way_state = coalesce(
        record -> 'state_hashes' ->> (jsonb_array_length(record -> 'state_hashes') / 2), record_digest
    )
    WHERE id > :after AND id <= :up_to
"""
"""A record without states, which the evaluator never writes, is like no other one."""


def upgrade() -> None:
    """Add the states, and search by them instead of the digests of whole episodes, which they are equal with."""
    op.add_column("episode_results", sa.Column("half_way_state", sa.String(length=64), nullable=True))
    connection = op.get_bind()
    last = connection.scalar(sa.text("SELECT coalesce(max(id), 0) FROM episode_results"))
    for after in range(0, last, IDS_AT_ONCE):
        connection.execute(sa.text(FILL), {"after": after, "up_to": after + IDS_AT_ONCE})
    op.alter_column("episode_results", "half_way_state", nullable=False)
    op.create_index("ix_episode_results_half_way_state", "episode_results", ["half_way_state"])
    op.drop_index("ix_episode_results_states", "episode_results")


def downgrade() -> None:
    """Compare whole episodes only, as before."""
    op.create_index("ix_episode_results_states", "episode_results", ["states_digest", "task", "episode"])
    op.drop_index("ix_episode_results_half_way_state", "episode_results")
    op.drop_column("episode_results", "half_way_state")
