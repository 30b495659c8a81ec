"""Evaluations play the public list beside the sealed one that ranks: which list a shard plays, and the scores of both.

Revision 0004, after 0003.
"""

import sqlalchemy as sa
from alembic import op
from sqlalchemy.dialects import postgresql

revision = "0004"
down_revision = "0003"
branch_labels = None
depends_on = None

KEY = ("evaluation_id", "task", "number")
OLD_KEY = "uq_shards_evaluation_id_task_number"


def upgrade() -> None:
    """Add the columns; shards that are there play the list of their evaluation."""
    op.add_column("shards", sa.Column("commitment", sa.Text(), server_default="", nullable=False))
    op.execute(
        "UPDATE shards SET commitment = evaluations.commitment FROM evaluations "
        "WHERE evaluations.id = shards.evaluation_id AND evaluations.commitment IS NOT NULL"
    )
    op.drop_constraint(OLD_KEY, "shards", type_="unique")
    op.create_unique_constraint("uq_shards_evaluation_id_task_number_commitment", "shards", [*KEY, "commitment"])
    op.add_column("evaluations", sa.Column("practice_scores", postgresql.JSONB(none_as_null=True), nullable=True))


def downgrade() -> None:
    """Remove the columns, and the shards that played the public list beside a sealed one."""
    op.drop_column("evaluations", "practice_scores")
    op.execute(
        "DELETE FROM shards USING evaluations WHERE evaluations.id = shards.evaluation_id "
        "AND shards.commitment <> coalesce(evaluations.commitment, '')"
    )
    op.drop_constraint("uq_shards_evaluation_id_task_number_commitment", "shards", type_="unique")
    op.create_unique_constraint(OLD_KEY, "shards", list(KEY))
    op.drop_column("shards", "commitment")
