"""Parts of the figures of a sensor are files of a submission, too."""

from alembic import op

revision = "0024"
down_revision = "0023"
branch_labels = None
depends_on = None

_TABLE, _NAME = "submission_files", "ck_submission_files_role"
_ROLES = "'sensor', 'document', 'coefficients'"


def upgrade() -> None:
    """Let a file be a part of the figures."""
    op.drop_constraint(op.f(_NAME), _TABLE, type_="check")
    op.create_check_constraint(op.f(_NAME), _TABLE, f"role IN ({_ROLES}, 'figures')")


def downgrade() -> None:
    """Forget the figures; the next evaluation measures them again."""
    op.execute(f"DELETE FROM {_TABLE} WHERE role = 'figures'")  # noqa: S608 - the name is a constant
    op.drop_constraint(op.f(_NAME), _TABLE, type_="check")
    op.create_check_constraint(op.f(_NAME), _TABLE, f"role IN ({_ROLES})")
