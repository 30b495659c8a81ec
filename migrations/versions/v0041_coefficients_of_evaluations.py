"""Coefficients say in which evaluations they were learned, and of which sensor."""

from alembic import op

revision = "0041"
down_revision = "0040"
branch_labels = None
depends_on = None

# Every completed evaluation has learned coefficients. Where a submission has only these and none is at work, all have
# learned these, of the sensor that is there. Of others nobody knows: the next evaluation learns them.
_KNOWN = """
    UPDATE submission_files AS learned SET facts = (
        SELECT coalesce(jsonb_object_agg(evaluations.id, made.sha256), '{}')
        FROM evaluations JOIN submission_files AS made USING (submission_id)
        WHERE evaluations.submission_id = learned.submission_id AND evaluations.state = 'completed'
        AND made.role = 'sensor'
        AND NOT EXISTS (
            SELECT FROM submission_files AS other
            WHERE other.submission_id = learned.submission_id AND other.role = 'coefficients'
            AND other.sha256 != learned.sha256
        )
        AND NOT EXISTS (
            SELECT FROM evaluations AS active
            WHERE active.submission_id = learned.submission_id AND active.state IN ('queued', 'running')
        )
    )
    WHERE role = 'coefficients'
"""


def upgrade() -> None:
    """Note the evaluations of which it is known."""
    op.execute(_KNOWN)


def downgrade() -> None:
    """Forget them."""
    op.execute("UPDATE submission_files SET facts = '{}' WHERE role = 'coefficients'")
