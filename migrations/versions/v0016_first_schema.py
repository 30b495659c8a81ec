"""The first schema: `v0016_first_schema.sql`, all tables with the triggers that guard them.

Databases of before the first release have lower revisions, and are refused.
"""

from pathlib import Path

from alembic import op

revision = "0016"
down_revision = None
branch_labels = None
depends_on = None

works_with_older = False
"""Whether a process of the release before this revision may go on with the schema: it only adds what that one does not
need. Each revision says so."""

REMOVE_ALL = """
    DO $$
    DECLARE name text;
    BEGIN
        FOR name IN SELECT tablename FROM pg_tables
            WHERE schemaname = current_schema() AND tablename <> 'alembic_version' LOOP
            EXECUTE format('DROP TABLE %I CASCADE', name);
        END LOOP;
        FOR name IN SELECT proname FROM pg_proc WHERE pronamespace = current_schema()::regnamespace LOOP
            EXECUTE format('DROP FUNCTION %I', name);
        END LOOP;
    END $$
"""


def upgrade() -> None:
    """Make tables and triggers."""
    # Without parameters: the file has many statements, with colons and percent signs that are none.
    connection = op.get_bind().execution_options(no_parameters=True)
    connection.exec_driver_sql(Path(__file__).with_suffix(".sql").read_text(encoding="utf-8"))


def downgrade() -> None:
    """Remove everything, with all rows."""
    op.execute(REMOVE_ALL)
