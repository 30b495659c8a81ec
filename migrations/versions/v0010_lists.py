"""What lists read without reading records or other teams' rows: an episode's shape, a team's submissions by time."""

import sqlalchemy as sa
from alembic import op

revision = "0010"
down_revision = "0009"
branch_labels = None
depends_on = None

IDS_AT_ONCE = 50_000
"""Records are large: one statement over all of them could run into the time limit of migrations."""


def upgrade() -> None:
    """Add column and index; the column is filled from the records."""
    op.add_column("episode_results", sa.Column("shape", sa.Text(), nullable=True))
    fill_shapes()
    op.alter_column("episode_results", "shape", nullable=False)
    op.create_index(
        "ix_submissions_of_team", "submissions", ["team_id", sa.text("submitted_at DESC"), sa.text("id DESC")]
    )


def fill_shapes() -> None:
    """Copy the shape out of all records."""
    connection = op.get_bind()
    last = connection.scalar(sa.text("SELECT coalesce(max(id), 0) FROM episode_results"))
    update = sa.text("UPDATE episode_results SET shape = record ->> 'shape' WHERE id > :after AND id <= :up_to")
    for after in range(0, last, IDS_AT_ONCE):
        connection.execute(update, {"after": after, "up_to": after + IDS_AT_ONCE})


def downgrade() -> None:
    """Remove both; the records still say the shape."""
    op.drop_index("ix_submissions_of_team", "submissions")
    op.drop_column("episode_results", "shape")
