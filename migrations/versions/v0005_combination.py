"""Drops the stored combination of an evaluation's scores: it is derived from them by today's rule where it is shown."""

import sqlalchemy as sa
from alembic import op

revision = "0005"
down_revision = "0004"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Remove both columns and what was asked of them."""
    op.drop_constraint(op.f("ck_evaluations_only_completed_has_a_score"), "evaluations")
    op.drop_column("evaluations", "success_rate")
    op.drop_column("evaluations", "mean_steps")
    op.create_check_constraint(
        op.f("ck_evaluations_only_completed_has_a_score"),
        "evaluations",
        "(state = 'completed') = (result_hash IS NOT NULL AND scores IS NOT NULL)",
    )


def downgrade() -> None:
    """Add them again with the mean of the tasks that were played; a track's other tasks are not known here."""
    op.add_column("evaluations", sa.Column("success_rate", sa.Float(), nullable=True))
    op.add_column("evaluations", sa.Column("mean_steps", sa.Float(), nullable=True))
    op.execute(
        """
        UPDATE evaluations SET
            success_rate = (SELECT avg((s->>'success_rate')::float) FROM jsonb_array_elements(scores) s),
            mean_steps = (
                SELECT CASE WHEN bool_and(s->>'mean_steps' IS NOT NULL) THEN avg((s->>'mean_steps')::float) END
                FROM jsonb_array_elements(scores) s
            )
        WHERE state = 'completed'
        """
    )
    op.drop_constraint(op.f("ck_evaluations_only_completed_has_a_score"), "evaluations")
    for name, condition in {
        "only_completed_has_a_score": (
            "(state = 'completed') = (result_hash IS NOT NULL AND scores IS NOT NULL AND success_rate IS NOT NULL)"
        ),
        "success_rate_is_a_fraction": "success_rate >= 0 AND success_rate <= 1",
        "mean_steps_is_finite": "mean_steps > 0 AND mean_steps < 1e9",
    }.items():
        op.create_check_constraint(op.f(f"ck_evaluations_{name}"), "evaluations", condition)
