"""Tables and functions of the job queue, by procrastinate's own migrations up to a named one.

They cannot run in one transaction (PostgreSQL before 17 refuses to use a new enum value in the one that adds it), so an
interrupted run is made good by beginning again: before this revision there is nothing in the queue that could be lost.

A later procrastinate that adds migrations needs a migration of ours that runs them; a test says so when the two differ.
"""

from importlib.resources import files

from alembic import op

revision = "0003"
down_revision = "0002"
branch_labels = None
depends_on = None

LAST_QUEUE_MIGRATION = "03.04.00_50_post_add_retry_failed_job_procedure.sql"


def upgrade() -> None:
    """Run procrastinate's migrations up to LAST_QUEUE_MIGRATION."""
    folder = files("procrastinate.sql") / "migrations"
    names = sorted(path.name for path in folder.iterdir() if path.name.endswith(".sql"))
    with op.get_context().autocommit_block():
        remove_queue()
        for name in names[: names.index(LAST_QUEUE_MIGRATION) + 1]:
            # Through the driver: the files hold colons and percent signs that SQLAlchemy would take for parameters.
            cursor = op.get_bind().connection.cursor()
            cursor.execute((folder / name).read_text(encoding="utf-8"))


def downgrade() -> None:
    """Remove the queue with all jobs."""
    remove_queue()


def remove_queue() -> None:
    """Drop whatever of the queue there is."""
    op.execute(
        """
        DO $$
        DECLARE name text;
        BEGIN
            FOR name IN SELECT c.relname FROM pg_class c
                WHERE c.relname LIKE 'procrastinate\\_%' AND c.relkind = 'r' LOOP
                EXECUTE format('DROP TABLE IF EXISTS %I CASCADE', name);
            END LOOP;
            FOR name IN SELECT p.oid::regprocedure::text FROM pg_proc p WHERE p.proname LIKE 'procrastinate\\_%' LOOP
                EXECUTE format('DROP FUNCTION IF EXISTS %s CASCADE', name);
            END LOOP;
            FOR name IN SELECT t.typname FROM pg_type t WHERE t.typname LIKE 'procrastinate\\_%' LOOP
                EXECUTE format('DROP TYPE IF EXISTS %I CASCADE', name);
            END LOOP;
        END $$
        """
    )
