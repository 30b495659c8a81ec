"""Triggers that let a state change only along its table of transitions, and keep the audit log append-only."""

from alembic import op

revision = "0002"
down_revision = "0001"
branch_labels = None
depends_on = None

TRANSITIONS = {
    "evaluations": (
        ("queued", "running"),
        ("queued", "failed"),
        ("queued", "cancelled"),
        ("running", "completed"),
        ("running", "failed"),
        ("running", "cancelled"),
    ),
    "shards": (
        ("queued", "running"),
        ("queued", "failed"),
        ("queued", "cancelled"),
        ("running", "queued"),
        ("running", "done"),
        ("running", "failed"),
        ("running", "cancelled"),
    ),
}


def upgrade() -> None:
    """Add the triggers."""
    for table, pairs in TRANSITIONS.items():
        allowed = ", ".join(f"('{old}', '{new}')" for old, new in pairs)
        op.execute(
            f"""
            CREATE FUNCTION check_{table}_transition() RETURNS trigger LANGUAGE plpgsql AS $$
            BEGIN
                IF (OLD.state, NEW.state) NOT IN ({allowed}) THEN
                    RAISE EXCEPTION '{table} % may not go from % to %', OLD.id, OLD.state, NEW.state
                        USING ERRCODE = 'check_violation', CONSTRAINT = 'ck_{table}_transition';
                END IF;
                RETURN NEW;
            END $$
            """
        )
        op.execute(
            f"""
            CREATE TRIGGER {table}_transition BEFORE UPDATE OF state ON {table} FOR EACH ROW
            WHEN (OLD.state IS DISTINCT FROM NEW.state) EXECUTE FUNCTION check_{table}_transition()
            """
        )
    op.execute(
        """
        CREATE FUNCTION refuse_audit_change() RETURNS trigger LANGUAGE plpgsql AS $$
        BEGIN
            RAISE EXCEPTION 'audit_log is append-only'
                USING ERRCODE = 'check_violation', CONSTRAINT = 'ck_audit_log_append_only';
        END $$
        """
    )
    op.execute(
        """
        CREATE TRIGGER audit_log_append_only BEFORE UPDATE OR DELETE ON audit_log
        FOR EACH ROW EXECUTE FUNCTION refuse_audit_change()
        """
    )


def downgrade() -> None:
    """Remove the triggers."""
    op.execute("DROP FUNCTION refuse_audit_change() CASCADE")
    for table in TRANSITIONS:
        op.execute(f"DROP FUNCTION check_{table}_transition() CASCADE")
