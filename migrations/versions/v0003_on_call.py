"""What whoever is on call needs: a shard's last progress, orders to workers, and a word when a submission changes."""

import sqlalchemy as sa
from alembic import op

revision = "0003"
down_revision = "0002"
branch_labels = None
depends_on = None

STATES = ("ready", "refusing", "stopped")
ORDERS = "worker_order IN ('work', 'cordon', 'drain')"
TOLD = {
    "evaluations": ("INSERT OR UPDATE", "NEW.submission_id"),
    "shards": (
        "UPDATE OF state, progressed_at",
        "(SELECT submission_id FROM evaluations WHERE id = NEW.evaluation_id)",
    ),
}
"""After which changes of a table is told of which submission; renewing a lease is none of them."""


def upgrade() -> None:
    """Add all three."""
    op.add_column("shards", sa.Column("progressed_at", sa.DateTime(timezone=True), nullable=True))
    op.add_column("workers", sa.Column("worker_order", sa.String(16), nullable=False, server_default="work"))
    op.create_check_constraint(op.f("ck_workers_worker_order"), "workers", ORDERS)
    _allow_states((*STATES, "cordoned"))
    for table, (event, submission) in TOLD.items():
        op.execute(
            f"""
            CREATE FUNCTION tell_of_{table}() RETURNS trigger LANGUAGE plpgsql AS $$
            BEGIN
                PERFORM pg_notify('vitac_submissions', {submission}::text);
                RETURN NULL;
            END $$
            """
        )
        op.execute(
            f"CREATE TRIGGER {table}_told AFTER {event} ON {table} FOR EACH ROW EXECUTE FUNCTION tell_of_{table}()"
        )


def downgrade() -> None:
    """Remove all three."""
    for table in TOLD:
        op.execute(f"DROP FUNCTION tell_of_{table}() CASCADE")
    op.execute("UPDATE workers SET state = 'stopped' WHERE state = 'cordoned'")
    _allow_states(STATES)
    op.drop_column("workers", "worker_order")
    op.drop_column("shards", "progressed_at")


def _allow_states(states: tuple[str, ...]) -> None:
    op.drop_constraint(op.f("ck_workers_state"), "workers", type_="check")
    op.create_check_constraint(op.f("ck_workers_state"), "workers", f"state IN ({', '.join(map(repr, states))})")
