"""What bounds teams: a quota of stored uploads, and addresses that get notices only once they are confirmed."""

import sqlalchemy as sa
from alembic import op

revision = "0002"
down_revision = "0001"
branch_labels = None
depends_on = None

QUOTAS = ("scored_runs_per_day", "attempts_per_day", "queued_at_once", "tokens", "event_streams")
KINDS = ("accepted", "finished", "failed", "promoted", "deadline", "announcement")


def upgrade() -> None:
    """Add both; addresses that there are already count as confirmed."""
    _allow("team_quotas", "quota", (*QUOTAS, "stored_mib"))
    _allow("notices", "kind", (*KINDS, "confirmation"))
    op.add_column("members", sa.Column("email_confirmed_at", sa.DateTime(timezone=True), nullable=True))
    op.add_column("members", sa.Column("email_code_sha256", sa.Text(), nullable=True))
    op.execute("UPDATE members SET email_confirmed_at = now() WHERE email IS NOT NULL")


def downgrade() -> None:
    """Remove both."""
    op.drop_column("members", "email_code_sha256")
    op.drop_column("members", "email_confirmed_at")
    op.execute("DELETE FROM notices WHERE kind = 'confirmation'")
    op.execute("DELETE FROM team_quotas WHERE quota = 'stored_mib'")
    _allow("notices", "kind", KINDS)
    _allow("team_quotas", "quota", QUOTAS)


def _allow(table: str, column: str, values: tuple[str, ...]) -> None:
    name = f"ck_{table}_{column}"
    op.drop_constraint(op.f(name), table, type_="check")
    op.create_check_constraint(op.f(name), table, f"{column} IN ({', '.join(map(repr, values))})")
