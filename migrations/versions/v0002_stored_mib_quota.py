"""A quota of stored uploads."""

from alembic import op

revision = "0002"
down_revision = "0001"
branch_labels = None
depends_on = None

NAME = "ck_team_quotas_quota"
BEFORE = ("scored_runs_per_day", "attempts_per_day", "queued_at_once", "tokens", "event_streams")
AFTER = ("scored_runs_per_day", "attempts_per_day", "queued_at_once", "stored_mib", "tokens", "event_streams")


def upgrade() -> None:
    """Let teams have limits of their own on it."""
    _allow(AFTER)


def downgrade() -> None:
    """Forget those limits."""
    op.execute("DELETE FROM team_quotas WHERE quota = 'stored_mib'")
    _allow(BEFORE)


def _allow(quotas: tuple[str, ...]) -> None:
    op.drop_constraint(op.f(NAME), "team_quotas", type_="check")
    op.create_check_constraint(op.f(NAME), "team_quotas", "quota IN ({})".format(", ".join(map(repr, quotas))))
