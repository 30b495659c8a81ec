"""The first schema: all tables, the triggers that guard them, and the tables and functions of the job queue.

The queue is made by procrastinate's own migrations up to a named one. They cannot run in one transaction (PostgreSQL
before 17 refuses to use a new enum value in the transaction that adds it), so they run first, and an interrupted run
begins again: before this revision the queue is empty. A later procrastinate that adds migrations needs a migration of
ours that runs them; a test fails when the two differ. Databases of before the first release have this revision, too.
"""

from importlib.resources import files

import sqlalchemy as sa
from alembic import op
from sqlalchemy.dialects import postgresql

revision = "0012"
down_revision = None
branch_labels = None
depends_on = None

works_with_older = False
"""Whether a process of the release before this revision may go on with the schema: it only adds what that one does not
need. Each revision says so."""

LAST_QUEUE_MIGRATION = "03.04.00_50_post_add_retry_failed_job_procedure.sql"

TABLES = (
    "announcements",
    "audit_log",
    "board_changes",
    "competition",
    "metric_totals",
    "receipt_key",
    "rejudgements",
    "schema_compatibility",
    "sealed_lists",
    "stations",
    "teams",
    "tree_nodes",
    "cosignatures",
    "workers",
    "declared_evaluators",
    "invitations",
    "judging_conflicts",
    "members",
    "notices",
    "qualifications",
    "questions",
    "submissions",
    "team_quotas",
    "webhooks",
    "api_tokens",
    "evaluations",
    "judging_marks",
    "partial_uploads",
    "submission_files",
    "appeals",
    "board_results",
    "episode_differences",
    "episode_results",
    "action_traces",
    "near_copies",
    "archive_copies",
    "log_copies",
    "receipts",
    "shards",
    "upload_parts",
    "appeal_replays",
    "playbacks",
)
"""All tables, each after those that it refers to."""

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
    "playbacks": (
        ("queued", "running"),
        ("queued", "failed"),
        ("running", "queued"),
        ("running", "made"),
        ("running", "failed"),
    ),
}
"""The changes of state that a table allows."""

NOTE = "INSERT INTO board_changes (mark) VALUES (hashtextextended(gen_random_uuid()::text, 0))"

NOTED_CHANGES = {
    "board_results": "INSERT OR UPDATE OR DELETE OR TRUNCATE",
    "log_copies": "INSERT OR UPDATE OR DELETE OR TRUNCATE",
    "submissions": "UPDATE OF team_id",
    "teams": "UPDATE OF name, named_at, disqualified_at OR DELETE",
}
"""Changes after which boards are read again, by table. A new team is on no board before its first result."""

APPEND_ONLY = {
    "audit_log": "refuse_audit_change",
    "receipts": "refuse_receipt_change",
    "tree_nodes": "refuse_tree_nodes_change",
    "cosignatures": "refuse_cosignatures_change",
}
"""Tables whose rows are never changed or removed, and the functions that refuse it."""

ANNOUNCED_CHANGES = {
    "evaluations": ("INSERT OR UPDATE", "NEW.submission_id"),
    "shards": (
        "UPDATE OF state, progressed_at",
        "(SELECT submission_id FROM evaluations WHERE id = NEW.evaluation_id)",
    ),
}
"""Changes of a table that listeners hear of, and the submission that they concern; renewing a lease is none of them."""

FUNCTIONS = (
    "note_board_change",
    "refuse_receipt_gap",
    *APPEND_ONLY.values(),
    *(f"check_{table}_transition" for table in TRANSITIONS),
    *(f"tell_of_{table}" for table in ANNOUNCED_CHANGES),
)


TIME, JSON = sa.DateTime(timezone=True), postgresql.JSONB()


def upgrade() -> None:
    """Make queue, tables and triggers."""
    make_queue()
    make_tables()
    op.execute(NOTE)
    op.execute("CREATE INDEX ix_procrastinate_jobs_shard_id ON procrastinate_jobs (((args ->> 'shard_id')::bigint))")
    for table, pairs in TRANSITIONS.items():
        guard_transitions(table, pairs)
    for table, function in APPEND_ONLY.items():
        refuse_changes(table, function)
    refuse_gaps_between_receipts()
    note_changes_of_boards()
    announce_changes()


def downgrade() -> None:
    """Remove everything, with all rows."""
    for table in reversed(TABLES):
        op.drop_table(table)
    for function in FUNCTIONS:
        op.execute(f"DROP FUNCTION {function}()")
    remove_queue()


def make_queue() -> None:
    """Run procrastinate's migrations up to LAST_QUEUE_MIGRATION."""
    folder = files("procrastinate.sql") / "migrations"
    names = sorted(path.name for path in folder.iterdir() if path.name.endswith(".sql"))
    with op.get_context().autocommit_block():
        remove_queue()
        for name in names[: names.index(LAST_QUEUE_MIGRATION) + 1]:
            # Through the driver: the files hold colons and percent signs that SQLAlchemy would take for parameters.
            cursor = op.get_bind().connection.cursor()
            cursor.execute((folder / name).read_text(encoding="utf-8"))


def remove_queue() -> None:
    """Drop everything of the queue that exists."""
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


def guard_transitions(table: str, allowed_pairs: tuple[tuple[str, str], ...]) -> None:
    """Let the state of a table's rows change only along its transitions."""
    allowed = ", ".join(f"('{old}', '{new}')" for old, new in allowed_pairs)
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


def refuse_changes(table: str, function: str) -> None:
    """Let a table only grow."""
    op.execute(
        f"""
        CREATE FUNCTION {function}() RETURNS trigger LANGUAGE plpgsql AS $$
        BEGIN
            RAISE EXCEPTION '{table} is append-only'
                USING ERRCODE = 'check_violation', CONSTRAINT = 'ck_{table}_append_only';
        END $$
        """
    )
    for name, event, each in (("append_only", "UPDATE OR DELETE", "ROW"), ("not_emptied", "TRUNCATE", "STATEMENT")):
        op.execute(
            f"CREATE TRIGGER {table}_{name} BEFORE {event} ON {table} FOR EACH {each} EXECUTE FUNCTION {function}()"
        )


def refuse_gaps_between_receipts() -> None:
    """Let each receipt follow the one before."""
    op.execute(
        """
        CREATE FUNCTION refuse_receipt_gap() RETURNS trigger LANGUAGE plpgsql AS $$
        BEGIN
            IF NEW.number <> (SELECT coalesce(max(number), 0) + 1 FROM receipts) THEN
                RAISE EXCEPTION 'receipt % does not follow the last one', NEW.number
                    USING ERRCODE = 'check_violation', CONSTRAINT = 'ck_receipts_without_gap';
            END IF;
            RETURN NEW;
        END $$
        """
    )
    op.execute(
        "CREATE TRIGGER receipts_without_gap BEFORE INSERT ON receipts "
        "FOR EACH ROW EXECUTE FUNCTION refuse_receipt_gap()"
    )


def note_changes_of_boards() -> None:
    """Write a note whenever a table behind the boards changes."""
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
    for table, changes in NOTED_CHANGES.items():
        op.execute(
            f"CREATE TRIGGER {table}_noted AFTER {changes} ON {table} "
            "FOR EACH STATEMENT EXECUTE FUNCTION note_board_change()"
        )


def announce_changes() -> None:
    """Notify listeners of the submission whose evaluation or shard has changed."""
    for table, (changes, submission) in ANNOUNCED_CHANGES.items():
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
            f"CREATE TRIGGER {table}_told AFTER {changes} ON {table} FOR EACH ROW EXECUTE FUNCTION tell_of_{table}()"
        )


def make_tables() -> None:
    """Make all tables, each after those that it refers to."""
    op.create_table(
        "announcements",
        sa.Column("id", sa.Integer(), primary_key=True),
        sa.Column("title", sa.String(length=120), nullable=False),
        sa.Column("text", sa.Text(), nullable=False),
        sa.Column("published_at", TIME, server_default=sa.text("now()"), nullable=False),
        sa.Column("withdrawn_at", TIME),
    )
    op.create_table(
        "audit_log",
        sa.Column("id", sa.BigInteger(), sa.Identity(always=True), primary_key=True),
        sa.Column("at", TIME, server_default=sa.text("now()"), nullable=False, index=True),
        sa.Column("actor", sa.Text(), nullable=False),
        sa.Column("action", sa.Text(), nullable=False),
        sa.Column("subject", sa.Text(), nullable=False),
        sa.Column("before", JSON),
        sa.Column("after", JSON, nullable=False),
    )
    op.create_table(
        "board_changes",
        sa.Column("id", sa.BigInteger(), sa.Identity(always=True), primary_key=True),
        sa.Column("mark", sa.BigInteger(), nullable=False),
    )
    op.create_table(
        "competition",
        sa.Column("name", sa.Text(), primary_key=True),
        sa.Column("definition", JSON, nullable=False),
        sa.Column("applied_at", TIME, server_default=sa.text("now()"), nullable=False),
        sa.Column("frozen_at", TIME),
        sa.Column("finalized_at", TIME),
        sa.Column("winners", JSON),
        sa.Column("boards", JSON),
        sa.Column("reopened", JSON, server_default="[]", nullable=False),
        sa.CheckConstraint("(finalized_at IS NULL) = (winners IS NULL)", name="final_has_winners"),
        sa.CheckConstraint("boards IS NULL OR finalized_at IS NOT NULL", name="only_final_has_boards"),
        sa.CheckConstraint("name <> ''", name="has_a_name"),
    )
    op.create_table(
        "metric_totals",
        sa.Column("name", sa.Text(), primary_key=True),
        sa.Column("labels", sa.Text(), primary_key=True),
        sa.Column("value", sa.Float(), nullable=False),
    )
    op.create_table(
        "receipt_key",
        sa.Column("id", sa.Integer(), server_default=sa.text("1"), autoincrement=False, primary_key=True),
        sa.Column("private_key", sa.String(length=64), nullable=False),
        sa.Column("public_key", sa.String(length=64), nullable=False),
        sa.Column("made_at", TIME, server_default=sa.text("now()"), nullable=False),
        sa.CheckConstraint("private_key ~ '^[0-9a-f]{64}$'", name="private_key_is_hexadecimal"),
        sa.CheckConstraint("id = 1", name="is_the_only_one"),
    )
    op.create_table(
        "rejudgements",
        sa.Column("id", sa.Uuid(), primary_key=True),
        sa.Column("competition", sa.Text(), server_default="", nullable=False),
        sa.Column("track", sa.Text(), nullable=False),
        sa.Column("stage", sa.Text(), nullable=False),
        sa.Column("reason", sa.Text(), nullable=False),
        sa.Column("started_at", TIME, server_default=sa.text("now()"), nullable=False),
        sa.Column("applied_at", TIME),
        sa.Column("discarded_at", TIME),
        sa.CheckConstraint("applied_at IS NULL OR discarded_at IS NULL", name="ends_in_one_way"),
    )
    op.create_table("schema_compatibility", sa.Column("oldest", sa.Text(), primary_key=True))
    op.create_table(
        "sealed_lists",
        sa.Column("commitment", sa.String(length=64), primary_key=True),
        sa.Column("competition", sa.Text(), nullable=False),
        sa.Column("track", sa.Text(), nullable=False),
        sa.Column("stage", sa.Text(), nullable=False),
        sa.Column("secret", sa.String(length=64), nullable=False),
        sa.Column("made_at", TIME, server_default=sa.text("now()"), nullable=False),
        sa.Column("revealed_at", TIME),
        sa.Column("withdrawn_at", TIME),
        sa.CheckConstraint("commitment ~ '^[0-9a-f]{64}$'", name="commitment_is_sha256"),
        sa.CheckConstraint("secret ~ '^[0-9a-f]{64}$'", name="secret_is_hexadecimal"),
        sa.UniqueConstraint("competition", "track", "stage", name=op.f("uq_sealed_lists_competition_track_stage")),
    )
    op.create_table(
        "stations",
        sa.Column("name", sa.Text(), primary_key=True),
        sa.Column("key_sha256", sa.Text(), nullable=False, unique=True),
        sa.Column("worker_id", sa.Uuid()),
        sa.Column("created_at", TIME, server_default=sa.text("now()"), nullable=False),
    )
    op.create_table(
        "teams",
        sa.Column("id", sa.Uuid(), primary_key=True),
        sa.Column("name", sa.String(length=64), nullable=False),
        sa.Column("name_key", sa.String(length=64), nullable=False, unique=True),
        sa.Column("contact", sa.String(length=254)),
        sa.Column("created_at", TIME, server_default=sa.text("now()"), nullable=False),
        sa.Column("disqualified_at", TIME),
        sa.Column("disqualified_for", sa.Text()),
        sa.Column("approved_at", TIME),
        sa.Column("refused_for", sa.Text()),
        sa.Column("named_at", TIME, server_default=sa.text("now()"), nullable=False),
        sa.Column("erased_at", TIME),
        sa.Column(
            "pseudonym",
            sa.String(length=64),
            server_default=sa.text("('Team '::text || upper(substr(md5((gen_random_uuid())::text), 1, 10)))"),
            nullable=False,
        ),
        sa.CheckConstraint("(disqualified_at IS NULL) = (disqualified_for IS NULL)", name="disqualified_for_a_reason"),
        sa.CheckConstraint("approved_at IS NULL OR refused_for IS NULL", name="is_accepted_or_refused"),
    )
    op.create_table(
        "tree_nodes",
        sa.Column("level", sa.SmallInteger(), autoincrement=False, primary_key=True),
        sa.Column("number", sa.BigInteger(), autoincrement=False, primary_key=True),
        sa.Column("hash", sa.LargeBinary(), nullable=False),
    )
    op.create_table(
        "cosignatures",
        sa.Column("witness", sa.Text(), primary_key=True),
        sa.Column("size", sa.BigInteger(), autoincrement=False, primary_key=True),
        sa.Column("signature", sa.LargeBinary(), nullable=False),
        sa.Column("signed_at", TIME, nullable=False),
    )
    op.create_table(
        "workers",
        sa.Column("id", sa.Uuid(), primary_key=True),
        sa.Column("host", sa.Text(), nullable=False),
        sa.Column("pid", sa.Integer(), nullable=False),
        sa.Column("slots", sa.Integer(), nullable=False),
        sa.Column("state", sa.String(length=16), nullable=False),
        sa.Column("evaluator_version", sa.Text(), nullable=False),
        sa.Column("families", postgresql.ARRAY(sa.Text()), server_default="{tactile}", nullable=False),
        sa.Column("platform_class", sa.Text(), nullable=False),
        sa.Column("isolation", sa.Text(), nullable=False),
        sa.Column("message", sa.Text(), nullable=False),
        sa.Column("started_at", TIME, server_default=sa.text("now()"), nullable=False),
        sa.Column("heartbeat_at", TIME, server_default=sa.text("now()"), nullable=False, index=True),
        sa.Column("disk_bytes", sa.BigInteger()),
        sa.Column("disk_free_bytes", sa.BigInteger()),
        sa.Column("sandbox", JSON),
        sa.Column("worker_order", sa.String(16), server_default="work", nullable=False),
        sa.CheckConstraint("worker_order IN ('work', 'cordon', 'drain')", name="worker_order"),
        sa.CheckConstraint("state IN ('ready', 'refusing', 'stopped', 'cordoned')", name="state"),
    )
    op.create_table(
        "declared_evaluators",
        sa.Column("track", sa.Text(), primary_key=True),
        sa.Column("version", sa.Text(), nullable=False),
        sa.Column("outdated", sa.String(16), server_default="restart", nullable=False),
        sa.CheckConstraint("outdated IN ('restart', 'finish')", name="outdated"),
    )
    op.create_table(
        "invitations",
        sa.Column("id", sa.Uuid(), primary_key=True),
        sa.Column("team_id", sa.Uuid(), sa.ForeignKey("teams.id", ondelete="CASCADE"), nullable=False, index=True),
        sa.Column("code_sha256", sa.String(length=64), nullable=False, unique=True),
        sa.Column("created_at", TIME, server_default=sa.text("now()"), nullable=False),
        sa.Column("expires_at", TIME, nullable=False),
        sa.Column("used_at", TIME),
        sa.Column("revoked_at", TIME),
        sa.CheckConstraint("length(code_sha256) = 64", name="code_is_hashed"),
        sa.CheckConstraint("used_at IS NULL OR revoked_at IS NULL", name="is_used_or_revoked"),
    )
    op.create_table(
        "judging_conflicts",
        sa.Column("team_id", sa.Uuid(), sa.ForeignKey("teams.id", ondelete="CASCADE"), primary_key=True),
        sa.Column("judge", sa.Text(), primary_key=True),
        sa.Column("reason", sa.Text(), nullable=False),
        sa.Column("declared_at", TIME, server_default=sa.text("now()"), nullable=False),
    )
    op.create_table(
        "members",
        sa.Column("id", sa.Uuid(), primary_key=True),
        sa.Column("team_id", sa.Uuid(), sa.ForeignKey("teams.id", ondelete="CASCADE"), nullable=False),
        sa.Column("role", sa.String(length=16), nullable=False),
        sa.Column("name", sa.String(length=64), nullable=False),
        sa.Column("name_key", sa.String(length=64), nullable=False),
        sa.Column("email", sa.String(length=254)),
        sa.Column("password_hash", sa.Text()),
        sa.Column("muted", postgresql.ARRAY(sa.Text()), server_default=sa.text("'{}'"), nullable=False),
        sa.Column("joined_at", TIME, server_default=sa.text("now()"), nullable=False),
        sa.Column("left_at", TIME),
        sa.Column("email_confirmed_at", TIME),
        sa.Column("email_code_sha256", sa.Text()),
        sa.CheckConstraint(
            "left_at IS NULL OR (password_hash IS NULL AND email IS NULL)", name="who_has_left_has_no_password"
        ),
        sa.CheckConstraint("role IN ('captain', 'member')", name="role"),
        sa.UniqueConstraint("team_id", "name_key", name=op.f("uq_members_team_id_name_key")),
    )
    op.create_index(
        "uq_members_captain",
        "members",
        ["team_id"],
        unique=True,
        postgresql_where=sa.text("role = 'captain' AND left_at IS NULL"),
    )
    op.create_table(
        "notices",
        sa.Column("id", sa.Uuid(), server_default=sa.text("gen_random_uuid()"), primary_key=True),
        sa.Column("kind", sa.String(length=16), nullable=False),
        sa.Column("team_id", sa.Uuid(), sa.ForeignKey("teams.id", ondelete="CASCADE"), nullable=False),
        sa.Column("subject", sa.Text(), nullable=False),
        sa.Column("channel", sa.String(length=16), nullable=False),
        sa.Column("target", sa.Text(), nullable=False),
        sa.Column("facts", JSON, nullable=False),
        sa.Column("created_at", TIME, server_default=sa.text("now()"), nullable=False),
        sa.Column("due_at", TIME, server_default=sa.text("now()"), nullable=False),
        sa.Column("attempts", sa.Integer(), server_default=sa.text("0"), nullable=False),
        sa.Column("sent_at", TIME),
        sa.Column("given_up_at", TIME),
        sa.Column("problem", sa.Text()),
        sa.CheckConstraint("attempts >= 0", name="attempts_are_counted"),
        sa.CheckConstraint("sent_at IS NULL OR given_up_at IS NULL", name="is_sent_or_given_up"),
        sa.CheckConstraint(
            "kind IN ('accepted', 'finished', 'failed', 'promoted', 'deadline', 'announcement', 'confirmation')",
            name="kind",
        ),
        sa.CheckConstraint("channel IN ('mail', 'webhook')", name="channel"),
        sa.UniqueConstraint("kind", "subject", "channel", "target", name="uq_notices_once"),
    )
    op.create_index(
        "ix_notices_due", "notices", ["due_at"], postgresql_where=sa.text("sent_at IS NULL AND given_up_at IS NULL")
    )
    op.create_index("ix_notices_of_team", "notices", ["team_id", "created_at"])
    op.create_table(
        "qualifications",
        sa.Column("competition", sa.Text(), primary_key=True),
        sa.Column("track", sa.Text(), primary_key=True),
        sa.Column("stage", sa.Text(), primary_key=True),
        sa.Column("team_id", sa.Uuid(), sa.ForeignKey("teams.id", ondelete="CASCADE"), primary_key=True),
        sa.Column("confirmed_at", TIME, server_default=sa.text("now()"), nullable=False),
    )
    op.create_table(
        "questions",
        sa.Column("id", sa.Integer(), primary_key=True),
        sa.Column("team_id", sa.Uuid(), sa.ForeignKey("teams.id", ondelete="SET NULL"), index=True),
        sa.Column("text", sa.Text(), nullable=False),
        sa.Column("public", sa.Boolean(), nullable=False),
        sa.Column("asked_at", TIME, server_default=sa.text("now()"), nullable=False),
        sa.Column("answer", sa.Text()),
        sa.Column("answered_at", TIME),
        sa.Column("hidden_at", TIME),
        sa.CheckConstraint("(answer IS NULL) = (answered_at IS NULL)", name="answer_has_a_time"),
    )
    op.create_table(
        "submissions",
        sa.Column("id", sa.Uuid(), primary_key=True),
        sa.Column("team_id", sa.Uuid(), sa.ForeignKey("teams.id", ondelete="RESTRICT"), nullable=False),
        sa.Column("kind", sa.String(length=16), nullable=False),
        sa.Column("competition", sa.Text(), server_default="", nullable=False),
        sa.Column("track", sa.Text(), nullable=False),
        sa.Column("stage", sa.Text(), server_default="", nullable=False),
        sa.Column("tasks", postgresql.ARRAY(sa.Text()), nullable=False),
        sa.Column("name", sa.String(length=128), nullable=False),
        sa.Column("digest", sa.String(length=64), nullable=False),
        sa.Column("archive_sha256", sa.String(length=64), nullable=False),
        sa.Column("archive_bytes", sa.BigInteger(), nullable=False),
        sa.Column("manifest", JSON, nullable=False),
        sa.Column("submitted_at", TIME, server_default=sa.text("now()"), nullable=False),
        sa.Column("merged_from", sa.Uuid()),
        sa.Column("is_public", sa.Boolean(), server_default=sa.false(), nullable=False),
        sa.Column("disqualified_at", TIME),
        sa.Column("disqualified_for", sa.Text()),
        sa.Column("copy_cleared_at", TIME),
        sa.Column("copy_cleared_for", sa.Text()),
        sa.Column("archive_sketch", sa.LargeBinary()),
        sa.Column("description", JSON),
        sa.Column("description_removed_for", sa.Text()),
        sa.Column("contents", JSON),
        sa.CheckConstraint("(copy_cleared_at IS NULL) = (copy_cleared_for IS NULL)", name="copy_cleared_for_a_reason"),
        sa.CheckConstraint("archive_sha256 ~ '^[0-9a-f]{64}$'", name="archive_sha256_is_sha256"),
        sa.CheckConstraint("digest ~ '^[0-9a-f]{64}$'", name="digest_is_sha256"),
        sa.CheckConstraint("archive_bytes > 0", name="archive_is_not_empty"),
        sa.CheckConstraint("(disqualified_at IS NULL) = (disqualified_for IS NULL)", name="disqualified_for_a_reason"),
        sa.CheckConstraint("kind IN ('model', 'log', 'text_log')", name="kind"),
    )
    op.create_index(
        "ix_submissions_of_team",
        "submissions",
        ["team_id", sa.literal_column("submitted_at DESC"), sa.literal_column("id DESC")],
    )
    op.create_index(
        "ix_submissions_submitted_at_id",
        "submissions",
        [sa.literal_column("submitted_at DESC"), sa.literal_column("id DESC")],
    )
    op.create_index(
        "uq_submissions_content",
        "submissions",
        ["team_id", "competition", "track", "stage", "kind", "digest"],
        unique=True,
        postgresql_where=sa.text("merged_from IS NULL"),
    )
    op.create_table(
        "team_quotas",
        sa.Column("team_id", sa.Uuid(), sa.ForeignKey("teams.id", ondelete="CASCADE"), primary_key=True),
        sa.Column("quota", sa.String(length=32), primary_key=True),
        sa.Column("most", sa.Integer()),
        sa.CheckConstraint("most >= 0", name="is_a_number"),
        sa.CheckConstraint(
            "quota IN ('scored_runs_per_day', 'attempts_per_day', 'queued_at_once', 'tokens', 'event_streams', "
            "'stored_mib')",
            name="quota",
        ),
    )
    op.create_table(
        "webhooks",
        sa.Column("id", sa.Uuid(), primary_key=True),
        sa.Column("team_id", sa.Uuid(), sa.ForeignKey("teams.id", ondelete="CASCADE"), nullable=False, index=True),
        sa.Column("address", sa.Text(), nullable=False),
        sa.Column("secret", sa.Text(), nullable=False),
        sa.Column("created_at", TIME, server_default=sa.text("now()"), nullable=False),
        sa.CheckConstraint("length(secret) = 64", name="secret_is_long"),
    )
    op.create_table(
        "api_tokens",
        sa.Column("id", sa.Uuid(), primary_key=True),
        sa.Column("role", sa.String(length=16), nullable=False),
        sa.Column("competition", sa.Text()),
        sa.Column("team_id", sa.Uuid(), sa.ForeignKey("teams.id", ondelete="CASCADE"), index=True),
        sa.Column("member_id", sa.Uuid(), sa.ForeignKey("members.id", ondelete="CASCADE"), index=True),
        sa.Column("is_session", sa.Boolean(), server_default=sa.false(), nullable=False),
        sa.Column("label", sa.String(length=64), nullable=False),
        sa.Column("secret_sha256", sa.String(length=64), nullable=False, unique=True),
        sa.Column("created_at", TIME, server_default=sa.text("now()"), nullable=False),
        sa.Column("expires_at", TIME),
        sa.Column("revoked_at", TIME),
        sa.Column("last_used_at", TIME),
        sa.CheckConstraint("competition IS NULL OR role = 'organizer'", name="a_competition_has_organizers"),
        sa.CheckConstraint("(role = 'team') = (team_id IS NOT NULL)", name="team_tokens_have_a_team"),
        sa.CheckConstraint("NOT is_session OR member_id IS NOT NULL", name="sessions_have_a_member"),
        sa.CheckConstraint("length(secret_sha256) = 64", name="secret_is_hashed"),
        sa.CheckConstraint("member_id IS NULL OR team_id IS NOT NULL", name="members_have_a_team"),
        sa.CheckConstraint("role IN ('team', 'judge', 'organizer')", name="role"),
    )
    op.create_index(
        "uq_api_tokens_of_member",
        "api_tokens",
        ["member_id"],
        unique=True,
        postgresql_where=sa.text("revoked_at IS NULL AND NOT is_session"),
    )
    op.create_table(
        "evaluations",
        sa.Column("id", sa.Uuid(), primary_key=True),
        sa.Column(
            "submission_id", sa.Uuid(), sa.ForeignKey("submissions.id", ondelete="RESTRICT"), nullable=False, index=True
        ),
        sa.Column("run", sa.Integer(), nullable=False),
        sa.Column("evaluator_version", sa.Text(), nullable=False),
        sa.Column("evaluator_hash", sa.String(length=64), nullable=False),
        sa.Column("platform_class", sa.Text()),
        sa.Column("commitment", sa.String(length=64), sa.ForeignKey("sealed_lists.commitment", ondelete="RESTRICT")),
        sa.Column("state", sa.String(length=16), nullable=False),
        sa.Column("episodes_reused", sa.Integer(), nullable=False),
        sa.Column("rejudgement_id", sa.Uuid(), sa.ForeignKey("rejudgements.id", ondelete="RESTRICT")),
        sa.Column("is_proposed", sa.Boolean(), server_default=sa.false(), nullable=False),
        sa.Column("turn", sa.Integer(), server_default=sa.text("0"), nullable=False),
        sa.Column("charged_at", TIME),
        sa.Column("asked_by_team", sa.Boolean(), server_default=sa.true(), nullable=False),
        sa.Column("created_at", TIME, server_default=sa.text("now()"), nullable=False),
        sa.Column("started_at", TIME),
        sa.Column("finished_at", TIME),
        sa.Column("verdict_code", sa.Text()),
        sa.Column("verdict_message", sa.Text()),
        sa.Column("verdict_task", sa.Text()),
        sa.Column("verdict_episode", sa.Integer()),
        sa.Column("log_tail", sa.Text(), nullable=False),
        sa.Column("scores", JSON),
        sa.Column("list_kind", sa.String(length=16), nullable=False),
        sa.Column("counted_tasks", postgresql.ARRAY(sa.Text())),
        sa.Column("result_hash", sa.String(length=64)),
        sa.Column("packages", JSON, server_default="[]", nullable=False),
        sa.Column("practice_scores", JSON),
        sa.Column("traceparent", sa.Text()),
        sa.CheckConstraint(
            "(state = 'completed') = (result_hash IS NOT NULL AND scores IS NOT NULL)",
            name="only_completed_has_a_score",
        ),
        sa.CheckConstraint("(state = 'failed') = (verdict_code IS NOT NULL)", name="only_failed_has_a_verdict"),
        sa.CheckConstraint(
            "(state IN ('completed', 'failed', 'cancelled')) = (finished_at IS NOT NULL)", name="finished_has_a_time"
        ),
        sa.CheckConstraint("evaluator_hash ~ '^[0-9a-f]{64}$'", name="evaluator_hash_is_sha256"),
        sa.CheckConstraint("result_hash ~ '^[0-9a-f]{64}$'", name="result_hash_is_sha256"),
        sa.CheckConstraint("NOT is_proposed OR rejudgement_id IS NOT NULL", name="proposed_by_a_rejudgement"),
        sa.CheckConstraint("run >= 1", name="run_counts_from_one"),
        sa.CheckConstraint("state IN ('queued', 'running', 'completed', 'failed', 'cancelled')", name="state"),
        sa.CheckConstraint("list_kind IN ('public', 'sealed')", name="list_kind"),
    )
    op.create_index(
        "ix_evaluations_charged_at", "evaluations", ["charged_at"], postgresql_where=sa.text("charged_at IS NOT NULL")
    )
    op.create_index(
        "ix_evaluations_rejudgement_id",
        "evaluations",
        ["rejudgement_id"],
        postgresql_where=sa.text("rejudgement_id IS NOT NULL"),
    )
    op.create_index("ix_evaluations_state_created_at", "evaluations", ["state", "created_at"])
    op.create_index(
        "uq_evaluations_active",
        "evaluations",
        ["submission_id"],
        unique=True,
        postgresql_where=sa.text("state IN ('queued', 'running')"),
    )
    op.create_index(
        "uq_evaluations_run",
        "evaluations",
        ["submission_id", "evaluator_version", "run"],
        unique=True,
        postgresql_where=sa.text("state IN ('queued', 'running', 'completed')"),
    )
    op.create_table(
        "judging_marks",
        sa.Column("submission_id", sa.Uuid(), sa.ForeignKey("submissions.id", ondelete="CASCADE"), primary_key=True),
        sa.Column("judge", sa.Text(), primary_key=True),
        sa.Column("criterion", sa.Text(), primary_key=True),
        sa.Column("mark", sa.Float(), nullable=False),
        sa.Column("given_at", TIME, server_default=sa.text("now()"), nullable=False),
        sa.CheckConstraint("mark >= 0 AND mark <= 10", name="mark_is_in_range"),
    )
    op.create_table(
        "partial_uploads",
        sa.Column("id", sa.Uuid(), primary_key=True),
        sa.Column("team_id", sa.Uuid(), sa.ForeignKey("teams.id", ondelete="CASCADE"), nullable=False, index=True),
        sa.Column("kind", sa.String(length=16), nullable=False),
        sa.Column("track", sa.Text()),
        sa.Column("competition", sa.Text()),
        sa.Column("again", sa.Boolean(), nullable=False),
        sa.Column("file_name", sa.Text()),
        sa.Column("total_bytes", sa.BigInteger(), nullable=False),
        sa.Column("received_bytes", sa.BigInteger(), nullable=False),
        sa.Column("sha256", sa.String(length=64)),
        sa.Column("created_at", TIME, server_default=sa.text("now()"), nullable=False),
        sa.Column("completed_at", TIME),
        sa.Column("expires_at", TIME, nullable=False, index=True),
        sa.Column("submission_id", sa.Uuid(), sa.ForeignKey("submissions.id", ondelete="CASCADE")),
        sa.CheckConstraint("sha256 ~ '^[0-9a-f]{64}$'", name="sha256_is_sha256"),
        sa.CheckConstraint("received_bytes >= 0 AND received_bytes <= total_bytes", name="received_is_a_part"),
        sa.CheckConstraint("total_bytes > 0", name="is_not_empty"),
        sa.CheckConstraint("kind IN ('model', 'log', 'text_log')", name="kind"),
    )
    op.create_table(
        "submission_files",
        sa.Column("submission_id", sa.Uuid(), sa.ForeignKey("submissions.id", ondelete="CASCADE"), primary_key=True),
        sa.Column("role", sa.String(length=16), primary_key=True),
        sa.Column("sha256", sa.String(length=64), primary_key=True),
        sa.Column("n_bytes", sa.BigInteger(), nullable=False),
        sa.Column("name", sa.String(length=128), nullable=False),
        sa.Column("facts", JSON, nullable=False),
        sa.CheckConstraint("sha256 ~ '^[0-9a-f]{64}$'", name="sha256_is_sha256"),
        sa.CheckConstraint("n_bytes > 0", name="is_not_empty"),
        sa.CheckConstraint("role IN ('sensor', 'document', 'coefficients', 'figures')", name="role"),
    )
    op.create_table(
        "appeals",
        sa.Column("id", sa.Integer(), primary_key=True),
        sa.Column("team_id", sa.Uuid(), sa.ForeignKey("teams.id", ondelete="CASCADE"), nullable=False, index=True),
        sa.Column("evaluation_id", sa.Uuid(), sa.ForeignKey("evaluations.id", ondelete="CASCADE"), nullable=False),
        sa.Column("task", sa.Text()),
        sa.Column("episode", sa.Integer()),
        sa.Column("text", sa.Text(), nullable=False),
        sa.Column("state", sa.String(length=16), nullable=False),
        sa.Column("opened_at", TIME, server_default=sa.text("now()"), nullable=False),
        sa.Column("ended_at", TIME),
        sa.Column("ruling", sa.Text()),
        sa.CheckConstraint("(state = 'open') = (ended_at IS NULL)", name="ended_has_a_time"),
        sa.CheckConstraint("(state IN ('upheld', 'rejected')) = (ruling IS NOT NULL)", name="ruled_on_has_a_ruling"),
        sa.CheckConstraint("(task IS NULL) = (episode IS NULL)", name="episodes_have_a_task"),
        sa.CheckConstraint("state IN ('open', 'upheld', 'rejected', 'withdrawn')", name="state"),
    )
    op.create_index(
        "uq_appeals_open", "appeals", ["evaluation_id"], unique=True, postgresql_where=sa.text("state = 'open'")
    )
    op.create_table(
        "board_results",
        sa.Column("evaluation_id", sa.Uuid(), sa.ForeignKey("evaluations.id", ondelete="CASCADE"), primary_key=True),
        sa.Column("board", sa.Text(), primary_key=True),
        sa.Column("competition", sa.Text(), server_default="", nullable=False),
        sa.Column("track", sa.Text(), nullable=False),
        sa.Column("stage", sa.Text(), server_default="", nullable=False),
        sa.Column("kind", sa.String(length=16), nullable=False),
        sa.Column("team_id", sa.Uuid(), sa.ForeignKey("teams.id", ondelete="RESTRICT"), nullable=False),
        sa.Column("submission_id", sa.Uuid(), sa.ForeignKey("submissions.id", ondelete="RESTRICT"), nullable=False),
        sa.Column("evaluator_version", sa.Text(), nullable=False),
        sa.Column("ranked_by", JSON, nullable=False),
        sa.Column("sort_key", postgresql.ARRAY(sa.Float()), nullable=False),
        sa.Column("submitted_at", TIME, nullable=False),
        sa.Column("finished_at", TIME, nullable=False),
        sa.Column("is_copy", sa.Boolean(), server_default=sa.false(), nullable=False),
        sa.Column("is_disqualified", sa.Boolean(), server_default=sa.false(), nullable=False),
        sa.CheckConstraint("kind IN ('model', 'log', 'text_log')", name="kind"),
    )
    op.create_index(
        "ix_board_results_of_team",
        "board_results",
        [
            "competition",
            "track",
            "stage",
            "kind",
            "board",
            "team_id",
            "sort_key",
            "evaluation_id",
        ],
    )
    op.create_index(
        "ix_board_results_of_version",
        "board_results",
        [
            "competition",
            "track",
            "stage",
            "kind",
            "board",
            "evaluator_version",
            "team_id",
            "sort_key",
            "evaluation_id",
        ],
    )
    op.create_table(
        "episode_differences",
        sa.Column("id", sa.BigInteger(), sa.Identity(always=True), primary_key=True),
        sa.Column("evaluation_id", sa.Uuid(), sa.ForeignKey("evaluations.id", ondelete="CASCADE"), nullable=False),
        sa.Column("task", sa.Text(), nullable=False),
        sa.Column("episode", sa.Integer(), nullable=False),
        sa.Column("stored_digest", sa.String(length=64), nullable=False),
        sa.Column("differing_digest", sa.String(length=64), nullable=False),
        sa.Column("worker_id", sa.Uuid()),
        sa.Column("seen_at", TIME, server_default=sa.text("now()"), nullable=False),
        sa.CheckConstraint("differing_digest ~ '^[0-9a-f]{64}$'", name="differing_digest_is_sha256"),
        sa.CheckConstraint("stored_digest ~ '^[0-9a-f]{64}$'", name="stored_digest_is_sha256"),
        sa.CheckConstraint("stored_digest <> differing_digest", name="records_differ"),
        sa.UniqueConstraint("evaluation_id", "task", "episode", "differing_digest", name="uq_episode_differences_key"),
    )
    op.create_table(
        "episode_results",
        sa.Column("id", sa.BigInteger(), sa.Identity(always=True), primary_key=True),
        sa.Column("submission_digest", sa.String(length=64), nullable=False),
        sa.Column("evaluator_version", sa.Text(), nullable=False),
        sa.Column("track", sa.Text(), nullable=False),
        sa.Column("task", sa.Text(), nullable=False),
        sa.Column("episode", sa.Integer(), nullable=False),
        sa.Column("run", sa.Integer(), nullable=False),
        sa.Column("commitment", sa.Text(), server_default="", nullable=False),
        sa.Column("shape", sa.Text(), nullable=False),
        sa.Column("outcome", sa.Text(), nullable=False),
        sa.Column("success", sa.Boolean(), nullable=False),
        sa.Column("env_steps", sa.Integer(), nullable=False),
        sa.Column("record", JSON, nullable=False),
        sa.Column("record_digest", sa.String(length=64), nullable=False),
        sa.Column("states_digest", sa.String(length=64), nullable=False),
        sa.Column("half_way_state", sa.String(length=64), nullable=False, index=True),
        sa.Column("wall_s", sa.Float(), nullable=False),
        sa.Column("output", sa.Text(), server_default="", nullable=False),
        sa.Column("evaluation_id", sa.Uuid(), sa.ForeignKey("evaluations.id", ondelete="SET NULL"), index=True),
        sa.Column("created_at", TIME, server_default=sa.text("now()"), nullable=False),
        sa.Column("forces", JSON),
        sa.CheckConstraint("record_digest ~ '^[0-9a-f]{64}$'", name="record_digest_is_sha256"),
        sa.CheckConstraint("submission_digest ~ '^[0-9a-f]{64}$'", name="submission_digest_is_sha256"),
        sa.CheckConstraint("success = (outcome = 'success')", name="success_is_the_outcome"),
        sa.CheckConstraint("episode >= 1 AND run >= 1 AND env_steps >= 0", name="counts_from_one"),
        sa.UniqueConstraint(
            "submission_digest",
            "evaluator_version",
            "track",
            "task",
            "episode",
            "run",
            "commitment",
            name="uq_episode_results_key",
        ),
    )
    op.create_index(
        "ix_episode_results_task_created_at", "episode_results", ["task", sa.literal_column("created_at DESC")]
    )
    op.create_table(
        "action_traces",
        sa.Column("evaluation_id", sa.Uuid(), sa.ForeignKey("evaluations.id", ondelete="CASCADE"), primary_key=True),
        sa.Column("task", sa.Text(), primary_key=True),
        sa.Column("commitment", sa.Text(), primary_key=True),
        sa.Column("action_size", sa.Integer(), nullable=False),
        sa.Column("actions", sa.LargeBinary(), nullable=False),
        sa.Column("paths", sa.LargeBinary(), server_default="", nullable=False),
    )
    op.create_index("ix_action_traces_task_commitment", "action_traces", ["task", "commitment"])
    op.create_table(
        "near_copies",
        sa.Column("evaluation_id", sa.Uuid(), sa.ForeignKey("evaluations.id", ondelete="CASCADE"), primary_key=True),
        sa.Column(
            "earlier_submission_id", sa.Uuid(), sa.ForeignKey("submissions.id", ondelete="CASCADE"), primary_key=True
        ),
        sa.Column("task", sa.Text(), primary_key=True),
        sa.Column("commitment", sa.Text(), primary_key=True),
        sa.Column("near", sa.Integer(), nullable=False),
        sa.Column("episodes", sa.Integer(), nullable=False),
        sa.Column("difference", sa.Float(), nullable=False),
        sa.Column("found_at", TIME, server_default=sa.text("now()"), nullable=False),
        sa.CheckConstraint("near > 0 AND near <= episodes", name="some_are_near"),
    )
    op.create_table(
        "archive_copies",
        sa.Column("submission_id", sa.Uuid(), sa.ForeignKey("submissions.id", ondelete="CASCADE"), primary_key=True),
        sa.Column(
            "earlier_submission_id", sa.Uuid(), sa.ForeignKey("submissions.id", ondelete="CASCADE"), primary_key=True
        ),
        sa.Column("code", sa.Float()),
        sa.Column("weights", sa.Float()),
        sa.Column("found_at", TIME, server_default=sa.text("now()"), nullable=False),
    )
    op.create_table(
        "log_copies",
        sa.Column("evaluation_id", sa.Uuid(), sa.ForeignKey("evaluations.id", ondelete="CASCADE"), primary_key=True),
        sa.Column(
            "earlier_submission_id", sa.Uuid(), sa.ForeignKey("submissions.id", ondelete="CASCADE"), nullable=False
        ),
        sa.Column("episodes", sa.Integer(), nullable=False),
        sa.Column("found_at", TIME, server_default=sa.text("now()"), nullable=False),
        sa.CheckConstraint("episodes > 0", name="some_are_equal"),
    )
    op.create_table(
        "receipts",
        sa.Column("number", sa.BigInteger(), autoincrement=False, primary_key=True),
        sa.Column("submission_id", sa.Uuid(), sa.ForeignKey("submissions.id", ondelete="RESTRICT"), unique=True),
        sa.Column("evaluation_id", sa.Uuid(), sa.ForeignKey("evaluations.id", ondelete="RESTRICT"), unique=True),
        sa.Column("stands_for", sa.Text(), nullable=False),
        sa.Column("content", sa.Text(), nullable=False),
        sa.Column("board", sa.Text(), nullable=False, index=True),
        sa.Column("entry", sa.Text(), nullable=False),
        sa.Column("leaf_hash", sa.LargeBinary(), nullable=False),
        sa.CheckConstraint("(stands_for = 'submission') = (submission_id IS NOT NULL)", name="arrival_has_submission"),
        sa.CheckConstraint("(stands_for = 'result') = (evaluation_id IS NOT NULL)", name="result_has_evaluation"),
        sa.CheckConstraint("octet_length(leaf_hash) = 32", name="leaf_hash_is_sha256"),
        sa.CheckConstraint("number >= 1", name="counts_from_one"),
    )
    op.create_table(
        "shards",
        sa.Column("id", sa.BigInteger(), sa.Identity(always=True), primary_key=True),
        sa.Column("evaluation_id", sa.Uuid(), sa.ForeignKey("evaluations.id", ondelete="CASCADE"), nullable=False),
        sa.Column("task", sa.Text(), nullable=False),
        sa.Column("number", sa.Integer(), nullable=False),
        sa.Column("episodes", postgresql.ARRAY(sa.Integer()), nullable=False),
        sa.Column("state", sa.String(length=16), nullable=False),
        sa.Column("token", sa.BigInteger(), nullable=False),
        sa.Column("attempts", sa.Integer(), nullable=False),
        sa.Column("worker_id", sa.Uuid()),
        sa.Column("lease_expires_at", TIME),
        sa.Column("manifest", JSON),
        sa.Column("isolation", sa.Text()),
        sa.Column("packages_digest", sa.String(length=64)),
        sa.Column("finding", JSON),
        sa.Column("queued_at", TIME, server_default=sa.text("now()"), nullable=False),
        sa.Column("started_at", TIME),
        sa.Column("finished_at", TIME),
        sa.Column("progressed_at", TIME),
        sa.Column("commitment", sa.Text(), server_default="", nullable=False),
        sa.CheckConstraint("(finding IS NOT NULL) <= (state = 'failed')", name="finding_is_a_failure"),
        sa.CheckConstraint("(state = 'done') <= (manifest IS NOT NULL)", name="done_has_a_manifest"),
        sa.CheckConstraint("(state = 'running') <= (worker_id IS NOT NULL)", name="running_has_a_worker"),
        sa.CheckConstraint("(state = 'running') = (lease_expires_at IS NOT NULL)", name="running_has_a_lease"),
        sa.CheckConstraint("attempts >= 0 AND token >= attempts", name="each_attempt_has_a_token"),
        sa.CheckConstraint("cardinality(episodes) > 0", name="has_episodes"),
        sa.CheckConstraint("state IN ('queued', 'running', 'done', 'failed', 'cancelled')", name="state"),
        sa.UniqueConstraint(
            "evaluation_id", "task", "number", "commitment", name=op.f("uq_shards_evaluation_id_task_number_commitment")
        ),
    )
    op.create_index("ix_shards_open", "shards", ["state"], postgresql_where=sa.text("state IN ('queued', 'running')"))
    op.create_table(
        "upload_parts",
        sa.Column("upload_id", sa.Uuid(), sa.ForeignKey("partial_uploads.id", ondelete="CASCADE"), primary_key=True),
        sa.Column("first_byte", sa.BigInteger(), autoincrement=False, primary_key=True),
        sa.Column("n_bytes", sa.Integer(), nullable=False),
        sa.Column("key", sa.Text(), nullable=False),
        sa.CheckConstraint("n_bytes > 0", name="is_not_empty"),
    )
    op.create_table(
        "appeal_replays",
        sa.Column("id", sa.Integer(), primary_key=True),
        sa.Column(
            "appeal_id", sa.Integer(), sa.ForeignKey("appeals.id", ondelete="CASCADE"), nullable=False, index=True
        ),
        sa.Column("task", sa.Text(), nullable=False),
        sa.Column("episode", sa.Integer(), nullable=False),
        sa.Column("policy_sha256", sa.String(length=64), nullable=False),
        sa.Column("corrected", sa.Boolean(), nullable=False),
        sa.Column("outcome", sa.Text(), nullable=False),
        sa.Column("env_steps", sa.Integer(), nullable=False),
        sa.Column("same_states", sa.Boolean(), nullable=False),
        sa.Column("old_outcome", sa.Text(), nullable=False),
        sa.Column("old_env_steps", sa.Integer(), nullable=False),
        sa.Column("played_at", TIME, server_default=sa.text("now()"), nullable=False),
        sa.CheckConstraint("policy_sha256 ~ '^[0-9a-f]{64}$'", name="policy_sha256_is_sha256"),
    )
    op.create_table(
        "playbacks",
        sa.Column("id", sa.BigInteger(), sa.Identity(always=True), primary_key=True),
        sa.Column("key", sa.String(length=64), nullable=False, unique=True),
        sa.Column(
            "episode_id",
            sa.BigInteger(),
            sa.ForeignKey("episode_results.id", ondelete="CASCADE"),
            nullable=False,
            index=True,
        ),
        sa.Column("evaluator_version", sa.Text(), nullable=False),
        sa.Column("state", sa.String(length=16), nullable=False),
        sa.Column("asked_by", sa.Text(), nullable=False),
        sa.Column("asked_at", TIME, server_default=sa.text("now()"), nullable=False, index=True),
        sa.Column("finished_at", TIME),
        sa.Column("env_steps_played", sa.Integer(), nullable=False),
        sa.Column("token", sa.BigInteger(), nullable=False),
        sa.Column("attempts", sa.Integer(), nullable=False),
        sa.Column("lease_expires_at", TIME),
        sa.Column("problem", sa.Text()),
        sa.Column("scene_sha256", sa.String(length=64)),
        sa.Column("cameras_sha256", sa.String(length=64)),
        sa.Column("still_sha256", sa.String(length=64)),
        sa.Column("film_sha256", sa.String(length=64)),
        sa.CheckConstraint("(state = 'failed') = (problem IS NOT NULL)", name="failed_has_a_problem"),
        sa.CheckConstraint(
            "(state = 'made') = (scene_sha256 IS NOT NULL OR film_sha256 IS NOT NULL)", name="made_has_scene_or_film"
        ),
        sa.CheckConstraint("(state = 'running') = (lease_expires_at IS NOT NULL)", name="running_has_a_lease"),
        sa.CheckConstraint("cameras_sha256 ~ '^[0-9a-f]{64}$'", name="cameras_sha256_is_sha256"),
        sa.CheckConstraint("film_sha256 ~ '^[0-9a-f]{64}$'", name="film_sha256_is_sha256"),
        sa.CheckConstraint("key ~ '^[0-9a-f]{64}$'", name="key_is_sha256"),
        sa.CheckConstraint("scene_sha256 ~ '^[0-9a-f]{64}$'", name="scene_sha256_is_sha256"),
        sa.CheckConstraint("still_sha256 ~ '^[0-9a-f]{64}$'", name="still_sha256_is_sha256"),
        sa.CheckConstraint("attempts >= 0 AND token >= attempts AND env_steps_played >= 0", name="counts_from_zero"),
        sa.CheckConstraint("state IN ('queued', 'running', 'made', 'failed')", name="state"),
    )
    op.create_index("ix_playbacks_asked_by_asked_at", "playbacks", ["asked_by", "asked_at"])
    op.create_index(
        "ix_playbacks_open", "playbacks", ["state"], postgresql_where=sa.text("state IN ('queued', 'running')")
    )
