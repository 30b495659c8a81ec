"""The audit log keeps what was before, and cannot be emptied; tokens of judges."""

import sqlalchemy as sa
from alembic import op
from sqlalchemy.dialects import postgresql

revision = "0017"
down_revision = "0016"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Add the column, the trigger and the role."""
    _rename("detail", "after")
    op.add_column("audit_log", sa.Column("before", postgresql.JSONB(), nullable=True))
    op.execute(
        """
        CREATE TRIGGER audit_log_not_emptied BEFORE TRUNCATE ON audit_log
        FOR EACH STATEMENT EXECUTE FUNCTION refuse_audit_change()
        """
    )
    _replace_checks(("team", "judge", "organizer"), "(role = 'team') = (team_id IS NOT NULL)")


def downgrade() -> None:
    """Remove them, with the tokens of judges."""
    op.execute("DELETE FROM api_tokens WHERE role = 'judge'")
    _replace_checks(("team", "organizer"), "(role = 'organizer') = (team_id IS NULL)")
    op.execute("DROP TRIGGER audit_log_not_emptied ON audit_log")
    op.drop_column("audit_log", "before")
    _rename("after", "detail")


def _replace_checks(roles: tuple[str, ...], has_team: str) -> None:
    for name in ("role", "team_tokens_have_a_team"):
        op.drop_constraint(op.f(f"ck_api_tokens_{name}"), "api_tokens", type_="check")
    listed = ", ".join(f"'{role}'" for role in roles)
    op.create_check_constraint(op.f("ck_api_tokens_role"), "api_tokens", f"role IN ({listed})")
    op.create_check_constraint(op.f("ck_api_tokens_team_tokens_have_a_team"), "api_tokens", has_team)


def _rename(old: str, new: str) -> None:
    """Rename a column and, where PostgreSQL names it after the column, its NOT NULL constraint."""
    op.alter_column("audit_log", old, nullable=True)
    op.alter_column("audit_log", old, new_column_name=new)
    op.alter_column("audit_log", new, nullable=False)
