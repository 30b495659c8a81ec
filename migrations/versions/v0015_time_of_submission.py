"""On boards counts when a submission was made, not when its evaluation was started, for instance again."""

from alembic import op

revision = "0015"
down_revision = "0014"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Take the time of the submission."""
    op.execute(
        "UPDATE board_results SET submitted_at = submissions.submitted_at "
        "FROM submissions WHERE submissions.id = board_results.submission_id"
    )


def downgrade() -> None:
    """Take the time of the evaluation again."""
    op.execute(
        "UPDATE board_results SET submitted_at = evaluations.created_at "
        "FROM evaluations WHERE evaluations.id = board_results.evaluation_id"
    )
