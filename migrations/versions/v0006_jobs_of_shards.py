"""Index on the shard that a job of the queue names: the sweep, withdrawing and forgetting look jobs up by it."""

from alembic import op

revision = "0006"
down_revision = "0005"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Add the index."""
    op.execute("CREATE INDEX ix_procrastinate_jobs_shard_id ON procrastinate_jobs (((args ->> 'shard_id')::bigint))")


def downgrade() -> None:
    """Remove the index."""
    op.execute("DROP INDEX ix_procrastinate_jobs_shard_id")
