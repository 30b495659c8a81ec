"""The first schema: all tables, the triggers that guard them, and the tables and functions of the job queue.

The queue is made by procrastinate's own migrations up to a named one. They cannot run in one transaction (PostgreSQL
before 17 refuses to use a new enum value in the transaction that adds it), so they run first, and an interrupted run
begins again: before this revision the queue is empty. A later procrastinate that adds migrations needs a migration of
ours that runs them; a test fails when the two differ.
"""

from importlib.resources import files

import sqlalchemy as sa
from alembic import op
from sqlalchemy.dialects import postgresql

revision = "0001"
down_revision = None
branch_labels = None
depends_on = None

LAST_QUEUE_MIGRATION = "03.04.00_50_post_add_retry_failed_job_procedure.sql"

TABLES = (
    "announcements",
    "audit_log",
    "board_changes",
    "competition",
    "metric_totals",
    "receipt_key",
    "rejudgements",
    "sealed_lists",
    "teams",
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

APPEND_ONLY = {"audit_log": "refuse_audit_change", "receipts": "refuse_receipt_change"}
"""Tables whose rows are never changed or removed, and the functions that refuse it."""

FUNCTIONS = (
    "note_board_change",
    "refuse_receipt_gap",
    *APPEND_ONLY.values(),
    *(f"check_{table}_transition" for table in TRANSITIONS),
)


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
            IF NEW.number <> (SELECT coalesce(max(number), 0) + 1 FROM receipts)
               OR NEW.previous IS DISTINCT FROM (SELECT digest FROM receipts ORDER BY number DESC LIMIT 1) THEN
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


def make_tables() -> None:
    """Make all tables, each after those that it refers to."""
    op.create_table(
        "announcements",
        sa.Column("id", sa.Integer(), nullable=False),
        sa.Column("title", sa.String(length=120), nullable=False),
        sa.Column("text", sa.Text(), nullable=False),
        sa.Column("published_at", sa.DateTime(timezone=True), server_default=sa.text("now()"), nullable=False),
        sa.Column("withdrawn_at", sa.DateTime(timezone=True), nullable=True),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_announcements")),
    )
    op.create_table(
        "audit_log",
        sa.Column("id", sa.BigInteger(), sa.Identity(always=True), nullable=False),
        sa.Column("at", sa.DateTime(timezone=True), server_default=sa.text("now()"), nullable=False),
        sa.Column("actor", sa.Text(), nullable=False),
        sa.Column("action", sa.Text(), nullable=False),
        sa.Column("subject", sa.Text(), nullable=False),
        sa.Column("before", postgresql.JSONB(none_as_null=True, astext_type=sa.Text()), nullable=True),
        sa.Column("after", postgresql.JSONB(astext_type=sa.Text()), nullable=False),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_audit_log")),
    )
    op.create_index(op.f("ix_audit_log_at"), "audit_log", ["at"], unique=False)
    op.create_table(
        "board_changes",
        sa.Column("id", sa.BigInteger(), sa.Identity(always=True), nullable=False),
        sa.Column("mark", sa.BigInteger(), nullable=False),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_board_changes")),
    )
    op.create_table(
        "competition",
        sa.Column("name", sa.Text(), nullable=False),
        sa.Column("definition", postgresql.JSONB(astext_type=sa.Text()), nullable=False),
        sa.Column("applied_at", sa.DateTime(timezone=True), server_default=sa.text("now()"), nullable=False),
        sa.Column("frozen_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("finalized_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("winners", postgresql.JSONB(none_as_null=True, astext_type=sa.Text()), nullable=True),
        sa.Column("boards", postgresql.JSONB(none_as_null=True, astext_type=sa.Text()), nullable=True),
        sa.Column("reopened", postgresql.JSONB(astext_type=sa.Text()), server_default="[]", nullable=False),
        sa.CheckConstraint("(finalized_at IS NULL) = (winners IS NULL)", name=op.f("ck_competition_final_has_winners")),
        sa.CheckConstraint(
            "boards IS NULL OR finalized_at IS NOT NULL", name=op.f("ck_competition_only_final_has_boards")
        ),
        sa.CheckConstraint("name <> ''", name=op.f("ck_competition_has_a_name")),
        sa.PrimaryKeyConstraint("name", name=op.f("pk_competition")),
    )
    op.create_table(
        "metric_totals",
        sa.Column("name", sa.Text(), nullable=False),
        sa.Column("labels", sa.Text(), nullable=False),
        sa.Column("value", sa.Float(), nullable=False),
        sa.PrimaryKeyConstraint("name", "labels", name=op.f("pk_metric_totals")),
    )
    op.create_table(
        "receipt_key",
        sa.Column("id", sa.Integer(), server_default=sa.text("1"), autoincrement=False, nullable=False),
        sa.Column("private_key", sa.String(length=64), nullable=False),
        sa.Column("public_key", sa.String(length=64), nullable=False),
        sa.Column("made_at", sa.DateTime(timezone=True), server_default=sa.text("now()"), nullable=False),
        sa.CheckConstraint("private_key ~ '^[0-9a-f]{64}$'", name=op.f("ck_receipt_key_private_key_is_hexadecimal")),
        sa.CheckConstraint("id = 1", name=op.f("ck_receipt_key_is_the_only_one")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_receipt_key")),
    )
    op.create_table(
        "rejudgements",
        sa.Column("id", sa.Uuid(), nullable=False),
        sa.Column("contest", sa.Text(), server_default="", nullable=False),
        sa.Column("track", sa.Text(), nullable=False),
        sa.Column("stage", sa.Text(), nullable=False),
        sa.Column("reason", sa.Text(), nullable=False),
        sa.Column("started_at", sa.DateTime(timezone=True), server_default=sa.text("now()"), nullable=False),
        sa.Column("applied_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("discarded_at", sa.DateTime(timezone=True), nullable=True),
        sa.CheckConstraint("applied_at IS NULL OR discarded_at IS NULL", name=op.f("ck_rejudgements_ends_in_one_way")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_rejudgements")),
    )
    op.create_table(
        "sealed_lists",
        sa.Column("commitment", sa.String(length=64), nullable=False),
        sa.Column("contest", sa.Text(), nullable=False),
        sa.Column("track", sa.Text(), nullable=False),
        sa.Column("stage", sa.Text(), nullable=False),
        sa.Column("secret", sa.String(length=64), nullable=False),
        sa.Column("made_at", sa.DateTime(timezone=True), server_default=sa.text("now()"), nullable=False),
        sa.Column("revealed_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("withdrawn_at", sa.DateTime(timezone=True), nullable=True),
        sa.CheckConstraint("commitment ~ '^[0-9a-f]{64}$'", name=op.f("ck_sealed_lists_commitment_is_sha256")),
        sa.CheckConstraint("secret ~ '^[0-9a-f]{64}$'", name=op.f("ck_sealed_lists_secret_is_hexadecimal")),
        sa.PrimaryKeyConstraint("commitment", name=op.f("pk_sealed_lists")),
        sa.UniqueConstraint("contest", "track", "stage", name=op.f("uq_sealed_lists_contest_track_stage")),
    )
    op.create_table(
        "teams",
        sa.Column("id", sa.Uuid(), nullable=False),
        sa.Column("name", sa.String(length=64), nullable=False),
        sa.Column("name_key", sa.String(length=64), nullable=False),
        sa.Column("contact", sa.String(length=254), nullable=True),
        sa.Column("created_at", sa.DateTime(timezone=True), server_default=sa.text("now()"), nullable=False),
        sa.Column("disqualified_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("disqualified_for", sa.Text(), nullable=True),
        sa.Column("approved_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("refused_for", sa.Text(), nullable=True),
        sa.Column("named_at", sa.DateTime(timezone=True), server_default=sa.text("now()"), nullable=False),
        sa.Column("erased_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column(
            "pseudonym",
            sa.String(length=64),
            server_default=sa.text("('Team '::text || upper(substr(md5((gen_random_uuid())::text), 1, 10)))"),
            nullable=False,
        ),
        sa.CheckConstraint(
            "(disqualified_at IS NULL) = (disqualified_for IS NULL)", name=op.f("ck_teams_disqualified_for_a_reason")
        ),
        sa.CheckConstraint("approved_at IS NULL OR refused_for IS NULL", name=op.f("ck_teams_is_accepted_or_refused")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_teams")),
        sa.UniqueConstraint("name_key", name=op.f("uq_teams_name_key")),
    )
    op.create_table(
        "workers",
        sa.Column("id", sa.Uuid(), nullable=False),
        sa.Column("host", sa.Text(), nullable=False),
        sa.Column("pid", sa.Integer(), nullable=False),
        sa.Column("slots", sa.Integer(), nullable=False),
        sa.Column(
            "state",
            sa.String(length=16),
            nullable=False,
        ),
        sa.Column("evaluator_version", sa.Text(), nullable=False),
        sa.Column("families", postgresql.ARRAY(sa.Text()), server_default="{tactile}", nullable=False),
        sa.Column("platform_class", sa.Text(), nullable=False),
        sa.Column("isolation", sa.Text(), nullable=False),
        sa.Column("message", sa.Text(), nullable=False),
        sa.Column("started_at", sa.DateTime(timezone=True), server_default=sa.text("now()"), nullable=False),
        sa.Column("heartbeat_at", sa.DateTime(timezone=True), server_default=sa.text("now()"), nullable=False),
        sa.Column("disk_bytes", sa.BigInteger(), nullable=True),
        sa.Column("disk_free_bytes", sa.BigInteger(), nullable=True),
        sa.Column("sandbox", postgresql.JSONB(none_as_null=True, astext_type=sa.Text()), nullable=True),
        sa.CheckConstraint("state IN ('ready', 'refusing', 'stopped')", name=op.f("ck_workers_state")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_workers")),
    )
    op.create_index(op.f("ix_workers_heartbeat_at"), "workers", ["heartbeat_at"], unique=False)
    op.create_table(
        "declared_evaluators",
        sa.Column("track", sa.Text(), nullable=False),
        sa.Column("version", sa.Text(), nullable=False),
        sa.PrimaryKeyConstraint("track", name=op.f("pk_declared_evaluators")),
    )
    op.create_table(
        "invitations",
        sa.Column("id", sa.Uuid(), nullable=False),
        sa.Column("team_id", sa.Uuid(), nullable=False),
        sa.Column("code_sha256", sa.String(length=64), nullable=False),
        sa.Column("created_at", sa.DateTime(timezone=True), server_default=sa.text("now()"), nullable=False),
        sa.Column("expires_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("used_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("revoked_at", sa.DateTime(timezone=True), nullable=True),
        sa.CheckConstraint("length(code_sha256) = 64", name=op.f("ck_invitations_code_is_hashed")),
        sa.CheckConstraint("used_at IS NULL OR revoked_at IS NULL", name=op.f("ck_invitations_is_used_or_revoked")),
        sa.ForeignKeyConstraint(["team_id"], ["teams.id"], name=op.f("fk_invitations_team_id"), ondelete="CASCADE"),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_invitations")),
        sa.UniqueConstraint("code_sha256", name=op.f("uq_invitations_code_sha256")),
    )
    op.create_index(op.f("ix_invitations_team_id"), "invitations", ["team_id"], unique=False)
    op.create_table(
        "judging_conflicts",
        sa.Column("team_id", sa.Uuid(), nullable=False),
        sa.Column("judge", sa.Text(), nullable=False),
        sa.Column("reason", sa.Text(), nullable=False),
        sa.Column("declared_at", sa.DateTime(timezone=True), server_default=sa.text("now()"), nullable=False),
        sa.ForeignKeyConstraint(
            ["team_id"], ["teams.id"], name=op.f("fk_judging_conflicts_team_id"), ondelete="CASCADE"
        ),
        sa.PrimaryKeyConstraint("team_id", "judge", name=op.f("pk_judging_conflicts")),
    )
    op.create_table(
        "members",
        sa.Column("id", sa.Uuid(), nullable=False),
        sa.Column("team_id", sa.Uuid(), nullable=False),
        sa.Column(
            "role",
            sa.String(length=16),
            nullable=False,
        ),
        sa.Column("name", sa.String(length=64), nullable=False),
        sa.Column("name_key", sa.String(length=64), nullable=False),
        sa.Column("email", sa.String(length=254), nullable=True),
        sa.Column("password_hash", sa.Text(), nullable=True),
        sa.Column("muted", postgresql.ARRAY(sa.Text()), server_default=sa.text("'{}'"), nullable=False),
        sa.Column("joined_at", sa.DateTime(timezone=True), server_default=sa.text("now()"), nullable=False),
        sa.Column("left_at", sa.DateTime(timezone=True), nullable=True),
        sa.CheckConstraint(
            "left_at IS NULL OR (password_hash IS NULL AND email IS NULL)",
            name=op.f("ck_members_who_has_left_has_no_password"),
        ),
        sa.ForeignKeyConstraint(["team_id"], ["teams.id"], name=op.f("fk_members_team_id"), ondelete="CASCADE"),
        sa.CheckConstraint("role IN ('captain', 'member')", name=op.f("ck_members_role")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_members")),
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
        sa.Column("id", sa.Uuid(), server_default=sa.text("gen_random_uuid()"), nullable=False),
        sa.Column(
            "kind",
            sa.String(length=16),
            nullable=False,
        ),
        sa.Column("team_id", sa.Uuid(), nullable=False),
        sa.Column("subject", sa.Text(), nullable=False),
        sa.Column(
            "channel",
            sa.String(length=16),
            nullable=False,
        ),
        sa.Column("target", sa.Text(), nullable=False),
        sa.Column("facts", postgresql.JSONB(astext_type=sa.Text()), nullable=False),
        sa.Column("created_at", sa.DateTime(timezone=True), server_default=sa.text("now()"), nullable=False),
        sa.Column("due_at", sa.DateTime(timezone=True), server_default=sa.text("now()"), nullable=False),
        sa.Column("attempts", sa.Integer(), server_default=sa.text("0"), nullable=False),
        sa.Column("sent_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("given_up_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("problem", sa.Text(), nullable=True),
        sa.CheckConstraint("attempts >= 0", name=op.f("ck_notices_attempts_are_counted")),
        sa.CheckConstraint("sent_at IS NULL OR given_up_at IS NULL", name=op.f("ck_notices_is_sent_or_given_up")),
        sa.ForeignKeyConstraint(["team_id"], ["teams.id"], name=op.f("fk_notices_team_id"), ondelete="CASCADE"),
        sa.CheckConstraint(
            "kind IN ('accepted', 'finished', 'failed', 'promoted', 'deadline', 'announcement')",
            name=op.f("ck_notices_kind"),
        ),
        sa.CheckConstraint("channel IN ('mail', 'webhook')", name=op.f("ck_notices_channel")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_notices")),
        sa.UniqueConstraint("kind", "subject", "channel", "target", name="uq_notices_once"),
    )
    op.create_index(
        "ix_notices_due",
        "notices",
        ["due_at"],
        unique=False,
        postgresql_where=sa.text("sent_at IS NULL AND given_up_at IS NULL"),
    )
    op.create_index("ix_notices_of_team", "notices", ["team_id", "created_at"], unique=False)
    op.create_table(
        "qualifications",
        sa.Column("contest", sa.Text(), nullable=False),
        sa.Column("track", sa.Text(), nullable=False),
        sa.Column("stage", sa.Text(), nullable=False),
        sa.Column("team_id", sa.Uuid(), nullable=False),
        sa.Column("confirmed_at", sa.DateTime(timezone=True), server_default=sa.text("now()"), nullable=False),
        sa.ForeignKeyConstraint(["team_id"], ["teams.id"], name=op.f("fk_qualifications_team_id"), ondelete="CASCADE"),
        sa.PrimaryKeyConstraint("contest", "track", "stage", "team_id", name=op.f("pk_qualifications")),
    )
    op.create_table(
        "questions",
        sa.Column("id", sa.Integer(), nullable=False),
        sa.Column("team_id", sa.Uuid(), nullable=True),
        sa.Column("text", sa.Text(), nullable=False),
        sa.Column("public", sa.Boolean(), nullable=False),
        sa.Column("asked_at", sa.DateTime(timezone=True), server_default=sa.text("now()"), nullable=False),
        sa.Column("answer", sa.Text(), nullable=True),
        sa.Column("answered_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("hidden_at", sa.DateTime(timezone=True), nullable=True),
        sa.CheckConstraint("(answer IS NULL) = (answered_at IS NULL)", name=op.f("ck_questions_answer_has_a_time")),
        sa.ForeignKeyConstraint(["team_id"], ["teams.id"], name=op.f("fk_questions_team_id"), ondelete="SET NULL"),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_questions")),
    )
    op.create_index(op.f("ix_questions_team_id"), "questions", ["team_id"], unique=False)
    op.create_table(
        "submissions",
        sa.Column("id", sa.Uuid(), nullable=False),
        sa.Column("team_id", sa.Uuid(), nullable=False),
        sa.Column(
            "kind",
            sa.String(length=16),
            nullable=False,
        ),
        sa.Column("contest", sa.Text(), server_default="", nullable=False),
        sa.Column("track", sa.Text(), nullable=False),
        sa.Column("stage", sa.Text(), server_default="", nullable=False),
        sa.Column("tasks", postgresql.ARRAY(sa.Text()), nullable=False),
        sa.Column("name", sa.String(length=128), nullable=False),
        sa.Column("digest", sa.String(length=64), nullable=False),
        sa.Column("archive_sha256", sa.String(length=64), nullable=False),
        sa.Column("archive_bytes", sa.BigInteger(), nullable=False),
        sa.Column("manifest", postgresql.JSONB(astext_type=sa.Text()), nullable=False),
        sa.Column("submitted_at", sa.DateTime(timezone=True), server_default=sa.text("now()"), nullable=False),
        sa.Column("merged_from", sa.Uuid(), nullable=True),
        sa.Column("is_public", sa.Boolean(), server_default=sa.false(), nullable=False),
        sa.Column("disqualified_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("disqualified_for", sa.Text(), nullable=True),
        sa.CheckConstraint("archive_sha256 ~ '^[0-9a-f]{64}$'", name=op.f("ck_submissions_archive_sha256_is_sha256")),
        sa.CheckConstraint("digest ~ '^[0-9a-f]{64}$'", name=op.f("ck_submissions_digest_is_sha256")),
        sa.CheckConstraint("archive_bytes > 0", name=op.f("ck_submissions_archive_is_not_empty")),
        sa.CheckConstraint(
            "(disqualified_at IS NULL) = (disqualified_for IS NULL)",
            name=op.f("ck_submissions_disqualified_for_a_reason"),
        ),
        sa.ForeignKeyConstraint(["team_id"], ["teams.id"], name=op.f("fk_submissions_team_id"), ondelete="RESTRICT"),
        sa.CheckConstraint("kind IN ('model', 'log', 'text_log')", name=op.f("ck_submissions_kind")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_submissions")),
    )
    op.create_index(
        "ix_submissions_of_team",
        "submissions",
        ["team_id", sa.literal_column("submitted_at DESC"), sa.literal_column("id DESC")],
        unique=False,
    )
    op.create_index(
        "ix_submissions_submitted_at_id",
        "submissions",
        [sa.literal_column("submitted_at DESC"), sa.literal_column("id DESC")],
        unique=False,
    )
    op.create_index(
        "uq_submissions_content",
        "submissions",
        ["team_id", "contest", "track", "stage", "kind", "digest"],
        unique=True,
        postgresql_where=sa.text("merged_from IS NULL"),
    )
    op.create_table(
        "team_quotas",
        sa.Column("team_id", sa.Uuid(), nullable=False),
        sa.Column(
            "quota",
            sa.String(length=32),
            nullable=False,
        ),
        sa.Column("most", sa.Integer(), nullable=True),
        sa.CheckConstraint("most >= 0", name=op.f("ck_team_quotas_is_a_number")),
        sa.ForeignKeyConstraint(["team_id"], ["teams.id"], name=op.f("fk_team_quotas_team_id"), ondelete="CASCADE"),
        sa.CheckConstraint(
            "quota IN ('scored_runs_per_day', 'attempts_per_day', 'queued_at_once', 'tokens', 'event_streams')",
            name=op.f("ck_team_quotas_quota"),
        ),
        sa.PrimaryKeyConstraint("team_id", "quota", name=op.f("pk_team_quotas")),
    )
    op.create_table(
        "webhooks",
        sa.Column("id", sa.Uuid(), nullable=False),
        sa.Column("team_id", sa.Uuid(), nullable=False),
        sa.Column("address", sa.Text(), nullable=False),
        sa.Column("secret", sa.Text(), nullable=False),
        sa.Column("created_at", sa.DateTime(timezone=True), server_default=sa.text("now()"), nullable=False),
        sa.CheckConstraint("length(secret) = 64", name=op.f("ck_webhooks_secret_is_long")),
        sa.ForeignKeyConstraint(["team_id"], ["teams.id"], name=op.f("fk_webhooks_team_id"), ondelete="CASCADE"),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_webhooks")),
    )
    op.create_index(op.f("ix_webhooks_team_id"), "webhooks", ["team_id"], unique=False)
    op.create_table(
        "api_tokens",
        sa.Column("id", sa.Uuid(), nullable=False),
        sa.Column(
            "role",
            sa.String(length=16),
            nullable=False,
        ),
        sa.Column("contest", sa.Text(), nullable=True),
        sa.Column("team_id", sa.Uuid(), nullable=True),
        sa.Column("member_id", sa.Uuid(), nullable=True),
        sa.Column("is_session", sa.Boolean(), server_default=sa.false(), nullable=False),
        sa.Column("label", sa.String(length=64), nullable=False),
        sa.Column("secret_sha256", sa.String(length=64), nullable=False),
        sa.Column("created_at", sa.DateTime(timezone=True), server_default=sa.text("now()"), nullable=False),
        sa.Column("expires_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("revoked_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("last_used_at", sa.DateTime(timezone=True), nullable=True),
        sa.CheckConstraint(
            "contest IS NULL OR role = 'organizer'", name=op.f("ck_api_tokens_a_contest_has_organizers")
        ),
        sa.CheckConstraint(
            "(role = 'team') = (team_id IS NOT NULL)", name=op.f("ck_api_tokens_team_tokens_have_a_team")
        ),
        sa.CheckConstraint(
            "NOT is_session OR member_id IS NOT NULL", name=op.f("ck_api_tokens_sessions_have_a_member")
        ),
        sa.CheckConstraint("length(secret_sha256) = 64", name=op.f("ck_api_tokens_secret_is_hashed")),
        sa.CheckConstraint("member_id IS NULL OR team_id IS NOT NULL", name=op.f("ck_api_tokens_members_have_a_team")),
        sa.ForeignKeyConstraint(
            ["member_id"], ["members.id"], name=op.f("fk_api_tokens_member_id"), ondelete="CASCADE"
        ),
        sa.ForeignKeyConstraint(["team_id"], ["teams.id"], name=op.f("fk_api_tokens_team_id"), ondelete="CASCADE"),
        sa.CheckConstraint("role IN ('team', 'judge', 'organizer')", name=op.f("ck_api_tokens_role")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_api_tokens")),
        sa.UniqueConstraint("secret_sha256", name=op.f("uq_api_tokens_secret_sha256")),
    )
    op.create_index(op.f("ix_api_tokens_member_id"), "api_tokens", ["member_id"], unique=False)
    op.create_index(op.f("ix_api_tokens_team_id"), "api_tokens", ["team_id"], unique=False)
    op.create_index(
        "uq_api_tokens_of_member",
        "api_tokens",
        ["member_id"],
        unique=True,
        postgresql_where=sa.text("revoked_at IS NULL AND NOT is_session"),
    )
    op.create_table(
        "evaluations",
        sa.Column("id", sa.Uuid(), nullable=False),
        sa.Column("submission_id", sa.Uuid(), nullable=False),
        sa.Column("run", sa.Integer(), nullable=False),
        sa.Column("evaluator_version", sa.Text(), nullable=False),
        sa.Column("evaluator_hash", sa.String(length=64), nullable=False),
        sa.Column("platform_class", sa.Text(), nullable=True),
        sa.Column("commitment", sa.String(length=64), nullable=True),
        sa.Column(
            "state",
            sa.String(length=16),
            nullable=False,
        ),
        sa.Column("episodes_reused", sa.Integer(), nullable=False),
        sa.Column("rejudgement_id", sa.Uuid(), nullable=True),
        sa.Column("is_proposed", sa.Boolean(), server_default=sa.false(), nullable=False),
        sa.Column("turn", sa.Integer(), server_default=sa.text("0"), nullable=False),
        sa.Column("charged_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("asked_by_team", sa.Boolean(), server_default=sa.true(), nullable=False),
        sa.Column("created_at", sa.DateTime(timezone=True), server_default=sa.text("now()"), nullable=False),
        sa.Column("started_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("finished_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("verdict_code", sa.Text(), nullable=True),
        sa.Column("verdict_message", sa.Text(), nullable=True),
        sa.Column("verdict_task", sa.Text(), nullable=True),
        sa.Column("verdict_episode", sa.Integer(), nullable=True),
        sa.Column("log_tail", sa.Text(), nullable=False),
        sa.Column("scores", postgresql.JSONB(none_as_null=True, astext_type=sa.Text()), nullable=True),
        sa.Column(
            "list_kind",
            sa.String(length=16),
            nullable=True,
        ),
        sa.Column("counted_tasks", postgresql.ARRAY(sa.Text()), nullable=True),
        sa.Column("result_hash", sa.String(length=64), nullable=True),
        sa.Column("packages", postgresql.JSONB(astext_type=sa.Text()), server_default="[]", nullable=False),
        sa.CheckConstraint(
            "(state = 'completed') = (result_hash IS NOT NULL AND scores IS NOT NULL)",
            name=op.f("ck_evaluations_only_completed_has_a_score"),
        ),
        sa.CheckConstraint(
            "(state = 'failed') = (verdict_code IS NOT NULL)", name=op.f("ck_evaluations_only_failed_has_a_verdict")
        ),
        sa.CheckConstraint(
            "(state IN ('completed', 'failed', 'cancelled')) = (finished_at IS NOT NULL)",
            name=op.f("ck_evaluations_finished_has_a_time"),
        ),
        sa.CheckConstraint("evaluator_hash ~ '^[0-9a-f]{64}$'", name=op.f("ck_evaluations_evaluator_hash_is_sha256")),
        sa.CheckConstraint("result_hash ~ '^[0-9a-f]{64}$'", name=op.f("ck_evaluations_result_hash_is_sha256")),
        sa.CheckConstraint(
            "NOT is_proposed OR rejudgement_id IS NOT NULL", name=op.f("ck_evaluations_proposed_by_a_rejudgement")
        ),
        sa.CheckConstraint("run >= 1", name=op.f("ck_evaluations_run_counts_from_one")),
        sa.ForeignKeyConstraint(
            ["commitment"], ["sealed_lists.commitment"], name=op.f("fk_evaluations_commitment"), ondelete="RESTRICT"
        ),
        sa.ForeignKeyConstraint(
            ["rejudgement_id"], ["rejudgements.id"], name=op.f("fk_evaluations_rejudgement_id"), ondelete="RESTRICT"
        ),
        sa.ForeignKeyConstraint(
            ["submission_id"], ["submissions.id"], name=op.f("fk_evaluations_submission_id"), ondelete="RESTRICT"
        ),
        sa.CheckConstraint(
            "state IN ('queued', 'running', 'completed', 'failed', 'cancelled')", name=op.f("ck_evaluations_state")
        ),
        sa.CheckConstraint("list_kind IN ('public', 'sealed')", name=op.f("ck_evaluations_list_kind")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_evaluations")),
    )
    op.create_index(
        "ix_evaluations_charged_at",
        "evaluations",
        ["charged_at"],
        unique=False,
        postgresql_where=sa.text("charged_at IS NOT NULL"),
    )
    op.create_index(
        "ix_evaluations_rejudgement_id",
        "evaluations",
        ["rejudgement_id"],
        unique=False,
        postgresql_where=sa.text("rejudgement_id IS NOT NULL"),
    )
    op.create_index("ix_evaluations_state_created_at", "evaluations", ["state", "created_at"], unique=False)
    op.create_index(op.f("ix_evaluations_submission_id"), "evaluations", ["submission_id"], unique=False)
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
        sa.Column("submission_id", sa.Uuid(), nullable=False),
        sa.Column("judge", sa.Text(), nullable=False),
        sa.Column("criterion", sa.Text(), nullable=False),
        sa.Column("mark", sa.Float(), nullable=False),
        sa.Column("given_at", sa.DateTime(timezone=True), server_default=sa.text("now()"), nullable=False),
        sa.CheckConstraint("mark >= 0 AND mark <= 10", name=op.f("ck_judging_marks_mark_is_in_range")),
        sa.ForeignKeyConstraint(
            ["submission_id"], ["submissions.id"], name=op.f("fk_judging_marks_submission_id"), ondelete="CASCADE"
        ),
        sa.PrimaryKeyConstraint("submission_id", "judge", "criterion", name=op.f("pk_judging_marks")),
    )
    op.create_table(
        "partial_uploads",
        sa.Column("id", sa.Uuid(), nullable=False),
        sa.Column("team_id", sa.Uuid(), nullable=False),
        sa.Column(
            "kind",
            sa.String(length=16),
            nullable=False,
        ),
        sa.Column("track", sa.Text(), nullable=True),
        sa.Column("contest", sa.Text(), nullable=True),
        sa.Column("again", sa.Boolean(), nullable=False),
        sa.Column("file_name", sa.Text(), nullable=True),
        sa.Column("total_bytes", sa.BigInteger(), nullable=False),
        sa.Column("received_bytes", sa.BigInteger(), nullable=False),
        sa.Column("sha256", sa.String(length=64), nullable=True),
        sa.Column("created_at", sa.DateTime(timezone=True), server_default=sa.text("now()"), nullable=False),
        sa.Column("completed_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("expires_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("submission_id", sa.Uuid(), nullable=True),
        sa.CheckConstraint("sha256 ~ '^[0-9a-f]{64}$'", name=op.f("ck_partial_uploads_sha256_is_sha256")),
        sa.CheckConstraint(
            "received_bytes >= 0 AND received_bytes <= total_bytes", name=op.f("ck_partial_uploads_received_is_a_part")
        ),
        sa.CheckConstraint("total_bytes > 0", name=op.f("ck_partial_uploads_is_not_empty")),
        sa.ForeignKeyConstraint(
            ["submission_id"], ["submissions.id"], name=op.f("fk_partial_uploads_submission_id"), ondelete="CASCADE"
        ),
        sa.ForeignKeyConstraint(["team_id"], ["teams.id"], name=op.f("fk_partial_uploads_team_id"), ondelete="CASCADE"),
        sa.CheckConstraint("kind IN ('model', 'log', 'text_log')", name=op.f("ck_partial_uploads_kind")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_partial_uploads")),
    )
    op.create_index(op.f("ix_partial_uploads_expires_at"), "partial_uploads", ["expires_at"], unique=False)
    op.create_index(op.f("ix_partial_uploads_team_id"), "partial_uploads", ["team_id"], unique=False)
    op.create_table(
        "submission_files",
        sa.Column("submission_id", sa.Uuid(), nullable=False),
        sa.Column(
            "role",
            sa.String(length=16),
            nullable=False,
        ),
        sa.Column("sha256", sa.String(length=64), nullable=False),
        sa.Column("n_bytes", sa.BigInteger(), nullable=False),
        sa.Column("name", sa.String(length=128), nullable=False),
        sa.Column("facts", postgresql.JSONB(astext_type=sa.Text()), nullable=False),
        sa.CheckConstraint("sha256 ~ '^[0-9a-f]{64}$'", name=op.f("ck_submission_files_sha256_is_sha256")),
        sa.CheckConstraint("n_bytes > 0", name=op.f("ck_submission_files_is_not_empty")),
        sa.ForeignKeyConstraint(
            ["submission_id"], ["submissions.id"], name=op.f("fk_submission_files_submission_id"), ondelete="CASCADE"
        ),
        sa.CheckConstraint(
            "role IN ('sensor', 'document', 'coefficients', 'figures')", name=op.f("ck_submission_files_role")
        ),
        sa.PrimaryKeyConstraint("submission_id", "role", "sha256", name=op.f("pk_submission_files")),
    )
    op.create_table(
        "appeals",
        sa.Column("id", sa.Integer(), nullable=False),
        sa.Column("team_id", sa.Uuid(), nullable=False),
        sa.Column("evaluation_id", sa.Uuid(), nullable=False),
        sa.Column("task", sa.Text(), nullable=True),
        sa.Column("episode", sa.Integer(), nullable=True),
        sa.Column("text", sa.Text(), nullable=False),
        sa.Column(
            "state",
            sa.String(length=16),
            nullable=False,
        ),
        sa.Column("opened_at", sa.DateTime(timezone=True), server_default=sa.text("now()"), nullable=False),
        sa.Column("ended_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("ruling", sa.Text(), nullable=True),
        sa.CheckConstraint("(state = 'open') = (ended_at IS NULL)", name=op.f("ck_appeals_ended_has_a_time")),
        sa.CheckConstraint(
            "(state IN ('upheld', 'rejected')) = (ruling IS NOT NULL)", name=op.f("ck_appeals_ruled_on_has_a_ruling")
        ),
        sa.CheckConstraint("(task IS NULL) = (episode IS NULL)", name=op.f("ck_appeals_episodes_have_a_task")),
        sa.ForeignKeyConstraint(
            ["evaluation_id"], ["evaluations.id"], name=op.f("fk_appeals_evaluation_id"), ondelete="CASCADE"
        ),
        sa.ForeignKeyConstraint(["team_id"], ["teams.id"], name=op.f("fk_appeals_team_id"), ondelete="CASCADE"),
        sa.CheckConstraint("state IN ('open', 'upheld', 'rejected', 'withdrawn')", name=op.f("ck_appeals_state")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_appeals")),
    )
    op.create_index(op.f("ix_appeals_team_id"), "appeals", ["team_id"], unique=False)
    op.create_index(
        "uq_appeals_open", "appeals", ["evaluation_id"], unique=True, postgresql_where=sa.text("state = 'open'")
    )
    op.create_table(
        "board_results",
        sa.Column("evaluation_id", sa.Uuid(), nullable=False),
        sa.Column("board", sa.Text(), nullable=False),
        sa.Column("contest", sa.Text(), server_default="", nullable=False),
        sa.Column("track", sa.Text(), nullable=False),
        sa.Column("stage", sa.Text(), server_default="", nullable=False),
        sa.Column(
            "kind",
            sa.String(length=16),
            nullable=False,
        ),
        sa.Column("team_id", sa.Uuid(), nullable=False),
        sa.Column("submission_id", sa.Uuid(), nullable=False),
        sa.Column("evaluator_version", sa.Text(), nullable=False),
        sa.Column("success_rate", sa.Float(), nullable=False),
        sa.Column("mean_steps", sa.Float(), nullable=True),
        sa.Column("submitted_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("finished_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("is_copy", sa.Boolean(), server_default=sa.false(), nullable=False),
        sa.Column("is_disqualified", sa.Boolean(), server_default=sa.false(), nullable=False),
        sa.CheckConstraint("mean_steps < 'Infinity'", name=op.f("ck_board_results_mean_steps_is_finite")),
        sa.CheckConstraint(
            "success_rate >= 0 AND success_rate <= 1", name=op.f("ck_board_results_success_rate_is_a_fraction")
        ),
        sa.ForeignKeyConstraint(
            ["evaluation_id"], ["evaluations.id"], name=op.f("fk_board_results_evaluation_id"), ondelete="CASCADE"
        ),
        sa.ForeignKeyConstraint(
            ["submission_id"], ["submissions.id"], name=op.f("fk_board_results_submission_id"), ondelete="RESTRICT"
        ),
        sa.ForeignKeyConstraint(["team_id"], ["teams.id"], name=op.f("fk_board_results_team_id"), ondelete="RESTRICT"),
        sa.CheckConstraint("kind IN ('model', 'log', 'text_log')", name=op.f("ck_board_results_kind")),
        sa.PrimaryKeyConstraint("evaluation_id", "board", name=op.f("pk_board_results")),
    )
    op.create_index(
        "ix_board_results_of_team",
        "board_results",
        [
            "contest",
            "track",
            "stage",
            "kind",
            "board",
            "team_id",
            sa.literal_column("success_rate DESC"),
            sa.literal_column("mean_steps"),
            sa.literal_column("submitted_at"),
            sa.literal_column("evaluation_id"),
        ],
        unique=False,
    )
    op.create_index(
        "ix_board_results_of_version",
        "board_results",
        [
            "contest",
            "track",
            "stage",
            "kind",
            "board",
            "evaluator_version",
            "team_id",
            sa.literal_column("success_rate DESC"),
            sa.literal_column("mean_steps"),
            sa.literal_column("submitted_at"),
            sa.literal_column("evaluation_id"),
        ],
        unique=False,
    )
    op.create_table(
        "episode_differences",
        sa.Column("id", sa.BigInteger(), sa.Identity(always=True), nullable=False),
        sa.Column("evaluation_id", sa.Uuid(), nullable=False),
        sa.Column("task", sa.Text(), nullable=False),
        sa.Column("episode", sa.Integer(), nullable=False),
        sa.Column("stored_digest", sa.String(length=64), nullable=False),
        sa.Column("differing_digest", sa.String(length=64), nullable=False),
        sa.Column("worker_id", sa.Uuid(), nullable=True),
        sa.Column("seen_at", sa.DateTime(timezone=True), server_default=sa.text("now()"), nullable=False),
        sa.CheckConstraint(
            "differing_digest ~ '^[0-9a-f]{64}$'", name=op.f("ck_episode_differences_differing_digest_is_sha256")
        ),
        sa.CheckConstraint(
            "stored_digest ~ '^[0-9a-f]{64}$'", name=op.f("ck_episode_differences_stored_digest_is_sha256")
        ),
        sa.CheckConstraint("stored_digest <> differing_digest", name=op.f("ck_episode_differences_records_differ")),
        sa.ForeignKeyConstraint(
            ["evaluation_id"], ["evaluations.id"], name=op.f("fk_episode_differences_evaluation_id"), ondelete="CASCADE"
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_episode_differences")),
        sa.UniqueConstraint("evaluation_id", "task", "episode", "differing_digest", name="uq_episode_differences_key"),
    )
    op.create_table(
        "episode_results",
        sa.Column("id", sa.BigInteger(), sa.Identity(always=True), nullable=False),
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
        sa.Column("record", postgresql.JSONB(astext_type=sa.Text()), nullable=False),
        sa.Column("record_digest", sa.String(length=64), nullable=False),
        sa.Column("states_digest", sa.String(length=64), nullable=False),
        sa.Column("half_way_state", sa.String(length=64), nullable=False),
        sa.Column("wall_s", sa.Float(), nullable=False),
        sa.Column("output", sa.Text(), server_default="", nullable=False),
        sa.Column("evaluation_id", sa.Uuid(), nullable=True),
        sa.Column("created_at", sa.DateTime(timezone=True), server_default=sa.text("now()"), nullable=False),
        sa.CheckConstraint("record_digest ~ '^[0-9a-f]{64}$'", name=op.f("ck_episode_results_record_digest_is_sha256")),
        sa.CheckConstraint(
            "submission_digest ~ '^[0-9a-f]{64}$'", name=op.f("ck_episode_results_submission_digest_is_sha256")
        ),
        sa.CheckConstraint("success = (outcome = 'success')", name=op.f("ck_episode_results_success_is_the_outcome")),
        sa.CheckConstraint(
            "episode >= 1 AND run >= 1 AND env_steps >= 0", name=op.f("ck_episode_results_counts_from_one")
        ),
        sa.ForeignKeyConstraint(
            ["evaluation_id"], ["evaluations.id"], name=op.f("fk_episode_results_evaluation_id"), ondelete="SET NULL"
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_episode_results")),
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
    op.create_index(op.f("ix_episode_results_evaluation_id"), "episode_results", ["evaluation_id"], unique=False)
    op.create_index("ix_episode_results_half_way_state", "episode_results", ["half_way_state"], unique=False)
    op.create_index(
        "ix_episode_results_task_created_at",
        "episode_results",
        ["task", sa.literal_column("created_at DESC")],
        unique=False,
    )
    op.create_table(
        "log_copies",
        sa.Column("evaluation_id", sa.Uuid(), nullable=False),
        sa.Column("earlier_submission_id", sa.Uuid(), nullable=False),
        sa.Column("episodes", sa.Integer(), nullable=False),
        sa.Column("found_at", sa.DateTime(timezone=True), server_default=sa.text("now()"), nullable=False),
        sa.CheckConstraint("episodes > 0", name=op.f("ck_log_copies_some_are_equal")),
        sa.ForeignKeyConstraint(
            ["earlier_submission_id"],
            ["submissions.id"],
            name=op.f("fk_log_copies_earlier_submission_id"),
            ondelete="CASCADE",
        ),
        sa.ForeignKeyConstraint(
            ["evaluation_id"], ["evaluations.id"], name=op.f("fk_log_copies_evaluation_id"), ondelete="CASCADE"
        ),
        sa.PrimaryKeyConstraint("evaluation_id", name=op.f("pk_log_copies")),
    )
    op.create_table(
        "receipts",
        sa.Column("number", sa.BigInteger(), autoincrement=False, nullable=False),
        sa.Column("submission_id", sa.Uuid(), nullable=True),
        sa.Column("evaluation_id", sa.Uuid(), nullable=True),
        sa.Column("previous", sa.String(length=64), nullable=True),
        sa.Column("digest", sa.String(length=64), nullable=False),
        sa.Column("stands_for", sa.Text(), nullable=False),
        sa.Column("content", sa.Text(), nullable=False),
        sa.Column("content_sha256", sa.String(length=64), nullable=False),
        sa.Column("issued_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("public_key", sa.String(length=64), nullable=False),
        sa.Column("signature", sa.String(length=128), nullable=False),
        sa.Column("board", sa.Text(), nullable=False),
        sa.CheckConstraint(
            "stands_for IN ('submission', 'result', 'end')", name=op.f("ck_receipts_stands_for_something_known")
        ),
        sa.CheckConstraint(
            "(stands_for = 'submission') = (submission_id IS NOT NULL)", name=op.f("ck_receipts_arrival_has_submission")
        ),
        sa.CheckConstraint(
            "(stands_for = 'result') = (evaluation_id IS NOT NULL)", name=op.f("ck_receipts_result_has_evaluation")
        ),
        sa.CheckConstraint("digest ~ '^[0-9a-f]{64}$'", name=op.f("ck_receipts_digest_is_sha256")),
        sa.CheckConstraint(
            "(number = 1) = (previous IS NULL)", name=op.f("ck_receipts_only_the_first_has_none_before")
        ),
        sa.CheckConstraint("number >= 1", name=op.f("ck_receipts_counts_from_one")),
        sa.ForeignKeyConstraint(
            ["evaluation_id"], ["evaluations.id"], name=op.f("fk_receipts_evaluation_id"), ondelete="RESTRICT"
        ),
        sa.ForeignKeyConstraint(
            ["submission_id"], ["submissions.id"], name=op.f("fk_receipts_submission_id"), ondelete="RESTRICT"
        ),
        sa.ForeignKeyConstraint(
            ["previous"], ["receipts.digest"], name=op.f("fk_receipts_previous"), ondelete="RESTRICT"
        ),
        sa.PrimaryKeyConstraint("number", name=op.f("pk_receipts")),
        sa.UniqueConstraint("digest", name=op.f("uq_receipts_digest")),
        sa.UniqueConstraint("evaluation_id", name=op.f("uq_receipts_evaluation_id")),
        sa.UniqueConstraint("previous", name=op.f("uq_receipts_previous")),
        sa.UniqueConstraint("submission_id", name=op.f("uq_receipts_submission_id")),
    )
    op.create_index(op.f("ix_receipts_board"), "receipts", ["board"], unique=False)
    op.create_table(
        "shards",
        sa.Column("id", sa.BigInteger(), sa.Identity(always=True), nullable=False),
        sa.Column("evaluation_id", sa.Uuid(), nullable=False),
        sa.Column("task", sa.Text(), nullable=False),
        sa.Column("number", sa.Integer(), nullable=False),
        sa.Column("episodes", postgresql.ARRAY(sa.Integer()), nullable=False),
        sa.Column(
            "state",
            sa.String(length=16),
            nullable=False,
        ),
        sa.Column("token", sa.BigInteger(), nullable=False),
        sa.Column("attempts", sa.Integer(), nullable=False),
        sa.Column("worker_id", sa.Uuid(), nullable=True),
        sa.Column("lease_expires_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("manifest", postgresql.JSONB(none_as_null=True, astext_type=sa.Text()), nullable=True),
        sa.Column("isolation", sa.Text(), nullable=True),
        sa.Column("packages_digest", sa.String(length=64), nullable=True),
        sa.Column("finding", postgresql.JSONB(none_as_null=True, astext_type=sa.Text()), nullable=True),
        sa.Column("queued_at", sa.DateTime(timezone=True), server_default=sa.text("now()"), nullable=False),
        sa.Column("started_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("finished_at", sa.DateTime(timezone=True), nullable=True),
        sa.CheckConstraint("(finding IS NOT NULL) <= (state = 'failed')", name=op.f("ck_shards_finding_is_a_failure")),
        sa.CheckConstraint("(state = 'done') <= (manifest IS NOT NULL)", name=op.f("ck_shards_done_has_a_manifest")),
        sa.CheckConstraint(
            "(state = 'running') <= (worker_id IS NOT NULL)", name=op.f("ck_shards_running_has_a_worker")
        ),
        sa.CheckConstraint(
            "(state = 'running') = (lease_expires_at IS NOT NULL)", name=op.f("ck_shards_running_has_a_lease")
        ),
        sa.CheckConstraint("attempts >= 0 AND token >= attempts", name=op.f("ck_shards_each_attempt_has_a_token")),
        sa.CheckConstraint("cardinality(episodes) > 0", name=op.f("ck_shards_has_episodes")),
        sa.ForeignKeyConstraint(
            ["evaluation_id"], ["evaluations.id"], name=op.f("fk_shards_evaluation_id"), ondelete="CASCADE"
        ),
        sa.CheckConstraint(
            "state IN ('queued', 'running', 'done', 'failed', 'cancelled')", name=op.f("ck_shards_state")
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_shards")),
        sa.UniqueConstraint("evaluation_id", "task", "number", name=op.f("uq_shards_evaluation_id_task_number")),
    )
    op.create_index(
        "ix_shards_open", "shards", ["state"], unique=False, postgresql_where=sa.text("state IN ('queued', 'running')")
    )
    op.create_table(
        "upload_parts",
        sa.Column("upload_id", sa.Uuid(), nullable=False),
        sa.Column("first_byte", sa.BigInteger(), autoincrement=False, nullable=False),
        sa.Column("n_bytes", sa.Integer(), nullable=False),
        sa.Column("key", sa.Text(), nullable=False),
        sa.CheckConstraint("n_bytes > 0", name=op.f("ck_upload_parts_is_not_empty")),
        sa.ForeignKeyConstraint(
            ["upload_id"], ["partial_uploads.id"], name=op.f("fk_upload_parts_upload_id"), ondelete="CASCADE"
        ),
        sa.PrimaryKeyConstraint("upload_id", "first_byte", name=op.f("pk_upload_parts")),
    )
    op.create_table(
        "appeal_replays",
        sa.Column("id", sa.Integer(), nullable=False),
        sa.Column("appeal_id", sa.Integer(), nullable=False),
        sa.Column("task", sa.Text(), nullable=False),
        sa.Column("episode", sa.Integer(), nullable=False),
        sa.Column("policy_sha256", sa.String(length=64), nullable=False),
        sa.Column("corrected", sa.Boolean(), nullable=False),
        sa.Column("outcome", sa.Text(), nullable=False),
        sa.Column("env_steps", sa.Integer(), nullable=False),
        sa.Column("same_states", sa.Boolean(), nullable=False),
        sa.Column("old_outcome", sa.Text(), nullable=False),
        sa.Column("old_env_steps", sa.Integer(), nullable=False),
        sa.Column("played_at", sa.DateTime(timezone=True), server_default=sa.text("now()"), nullable=False),
        sa.CheckConstraint("policy_sha256 ~ '^[0-9a-f]{64}$'", name=op.f("ck_appeal_replays_policy_sha256_is_sha256")),
        sa.ForeignKeyConstraint(
            ["appeal_id"], ["appeals.id"], name=op.f("fk_appeal_replays_appeal_id"), ondelete="CASCADE"
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_appeal_replays")),
    )
    op.create_index(op.f("ix_appeal_replays_appeal_id"), "appeal_replays", ["appeal_id"], unique=False)
    op.create_table(
        "playbacks",
        sa.Column("id", sa.BigInteger(), sa.Identity(always=True), nullable=False),
        sa.Column("key", sa.String(length=64), nullable=False),
        sa.Column("episode_id", sa.BigInteger(), nullable=False),
        sa.Column("evaluator_version", sa.Text(), nullable=False),
        sa.Column(
            "state",
            sa.String(length=16),
            nullable=False,
        ),
        sa.Column("asked_by", sa.Text(), nullable=False),
        sa.Column("asked_at", sa.DateTime(timezone=True), server_default=sa.text("now()"), nullable=False),
        sa.Column("finished_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("env_steps_played", sa.Integer(), nullable=False),
        sa.Column("token", sa.BigInteger(), nullable=False),
        sa.Column("attempts", sa.Integer(), nullable=False),
        sa.Column("lease_expires_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("problem", sa.Text(), nullable=True),
        sa.Column("scene_sha256", sa.String(length=64), nullable=True),
        sa.Column("cameras_sha256", sa.String(length=64), nullable=True),
        sa.Column("still_sha256", sa.String(length=64), nullable=True),
        sa.Column("film_sha256", sa.String(length=64), nullable=True),
        sa.CheckConstraint(
            "(state = 'failed') = (problem IS NOT NULL)", name=op.f("ck_playbacks_failed_has_a_problem")
        ),
        sa.CheckConstraint(
            "(state = 'made') = (scene_sha256 IS NOT NULL OR film_sha256 IS NOT NULL)",
            name=op.f("ck_playbacks_made_has_scene_or_film"),
        ),
        sa.CheckConstraint(
            "(state = 'running') = (lease_expires_at IS NOT NULL)", name=op.f("ck_playbacks_running_has_a_lease")
        ),
        sa.CheckConstraint("cameras_sha256 ~ '^[0-9a-f]{64}$'", name=op.f("ck_playbacks_cameras_sha256_is_sha256")),
        sa.CheckConstraint("film_sha256 ~ '^[0-9a-f]{64}$'", name=op.f("ck_playbacks_film_sha256_is_sha256")),
        sa.CheckConstraint("key ~ '^[0-9a-f]{64}$'", name=op.f("ck_playbacks_key_is_sha256")),
        sa.CheckConstraint("scene_sha256 ~ '^[0-9a-f]{64}$'", name=op.f("ck_playbacks_scene_sha256_is_sha256")),
        sa.CheckConstraint("still_sha256 ~ '^[0-9a-f]{64}$'", name=op.f("ck_playbacks_still_sha256_is_sha256")),
        sa.CheckConstraint(
            "attempts >= 0 AND token >= attempts AND env_steps_played >= 0", name=op.f("ck_playbacks_counts_from_zero")
        ),
        sa.ForeignKeyConstraint(
            ["episode_id"], ["episode_results.id"], name=op.f("fk_playbacks_episode_id"), ondelete="CASCADE"
        ),
        sa.CheckConstraint("state IN ('queued', 'running', 'made', 'failed')", name=op.f("ck_playbacks_state")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_playbacks")),
        sa.UniqueConstraint("key", name=op.f("uq_playbacks_key")),
    )
    op.create_index(op.f("ix_playbacks_asked_at"), "playbacks", ["asked_at"], unique=False)
    op.create_index("ix_playbacks_asked_by_asked_at", "playbacks", ["asked_by", "asked_at"], unique=False)
    op.create_index(op.f("ix_playbacks_episode_id"), "playbacks", ["episode_id"], unique=False)
    op.create_index(
        "ix_playbacks_open",
        "playbacks",
        ["state"],
        unique=False,
        postgresql_where=sa.text("state IN ('queued', 'running')"),
    )
