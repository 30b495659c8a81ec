"""Notes of each change of the tables behind the boards, so that what was read of them can be kept until then."""

import sqlalchemy as sa
from alembic import op

revision = "0036"
down_revision = "0035"
branch_labels = None
depends_on = None

NOTE = "INSERT INTO board_changes (mark) VALUES (hashtextextended(gen_random_uuid()::text, 0))"

TRIGGERS = {
    "board_results": "INSERT OR UPDATE OR DELETE OR TRUNCATE",
    "log_copies": "INSERT OR UPDATE OR DELETE OR TRUNCATE",
    "submissions": "UPDATE OF team_id",
    "teams": "UPDATE OF name, named_at, disqualified_at OR DELETE",
}
"""Which changes are noted, by table. What boards show of a team that is added follows from its first result."""


def upgrade() -> None:
    """Add the table with a first note, and the triggers."""
    op.create_table(
        "board_changes",
        sa.Column("id", sa.BigInteger, sa.Identity(always=True), nullable=False),
        sa.Column("mark", sa.BigInteger, nullable=False),
        sa.PrimaryKeyConstraint("id", name="pk_board_changes"),
    )
    op.execute(NOTE)
    op.execute(
        f"""
        CREATE FUNCTION note_board_change() RETURNS trigger LANGUAGE plpgsql AS $$
        BEGIN
            {NOTE};
            RETURN NULL;
        END
        $$
        """
    )
    for table, changes in TRIGGERS.items():
        op.execute(
            f"CREATE TRIGGER {table}_noted AFTER {changes} ON {table} "
            "FOR EACH STATEMENT EXECUTE FUNCTION note_board_change()"
        )


def downgrade() -> None:
    """Remove them."""
    for table in TRIGGERS:
        op.execute(f"DROP TRIGGER {table}_noted ON {table}")
    op.execute("DROP FUNCTION note_board_change()")
    op.drop_table("board_changes")
