"""Tables of teams, tokens, submissions, evaluations, shards, episodes, workers and the audit log."""

import sqlalchemy as sa
from alembic import op
from sqlalchemy.dialects import postgresql

revision = "0001"
down_revision = None
branch_labels = None
depends_on = None

TABLES = (
    "audit_log",
    "teams",
    "workers",
    "api_tokens",
    "submissions",
    "evaluations",
    "episode_results",
    "shards",
)


def upgrade() -> None:
    """Make the tables."""
    op.create_table(
        "audit_log",
        sa.Column("id", sa.BigInteger(), sa.Identity(always=True), nullable=False),
        sa.Column("at", sa.DateTime(timezone=True), server_default=sa.text("now()"), nullable=False),
        sa.Column("actor", sa.Text(), nullable=False),
        sa.Column("action", sa.Text(), nullable=False),
        sa.Column("subject", sa.Text(), nullable=False),
        sa.Column("detail", postgresql.JSONB(astext_type=sa.Text()), nullable=False),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_audit_log")),
    )
    op.create_index(op.f("ix_audit_log_at"), "audit_log", ["at"], unique=False)
    op.create_table(
        "teams",
        sa.Column("id", sa.Uuid(), nullable=False),
        sa.Column("name", sa.String(length=64), nullable=False),
        sa.Column("name_key", sa.String(length=64), nullable=False),
        sa.Column("contact", sa.String(length=254), nullable=True),
        sa.Column("created_at", sa.DateTime(timezone=True), server_default=sa.text("now()"), nullable=False),
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
        sa.Column("platform_class", sa.Text(), nullable=False),
        sa.Column("isolation", sa.Text(), nullable=False),
        sa.Column("message", sa.Text(), nullable=False),
        sa.Column("started_at", sa.DateTime(timezone=True), server_default=sa.text("now()"), nullable=False),
        sa.Column("heartbeat_at", sa.DateTime(timezone=True), server_default=sa.text("now()"), nullable=False),
        sa.CheckConstraint("state IN ('ready', 'refusing', 'stopped')", name=op.f("ck_workers_state")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_workers")),
    )
    op.create_index(op.f("ix_workers_heartbeat_at"), "workers", ["heartbeat_at"], unique=False)
    op.create_table(
        "api_tokens",
        sa.Column("id", sa.Uuid(), nullable=False),
        sa.Column(
            "role",
            sa.String(length=16),
            nullable=False,
        ),
        sa.Column("team_id", sa.Uuid(), nullable=True),
        sa.Column("label", sa.String(length=64), nullable=False),
        sa.Column("secret_sha256", sa.String(length=64), nullable=False),
        sa.Column("created_at", sa.DateTime(timezone=True), server_default=sa.text("now()"), nullable=False),
        sa.Column("expires_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("revoked_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("last_used_at", sa.DateTime(timezone=True), nullable=True),
        sa.CheckConstraint(
            "(role = 'organizer') = (team_id IS NULL)", name=op.f("ck_api_tokens_team_tokens_have_a_team")
        ),
        sa.CheckConstraint("length(secret_sha256) = 64", name=op.f("ck_api_tokens_secret_is_hashed")),
        sa.ForeignKeyConstraint(["team_id"], ["teams.id"], name=op.f("fk_api_tokens_team_id"), ondelete="CASCADE"),
        sa.CheckConstraint("role IN ('team', 'organizer')", name=op.f("ck_api_tokens_role")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_api_tokens")),
        sa.UniqueConstraint("secret_sha256", name=op.f("uq_api_tokens_secret_sha256")),
    )
    op.create_index(op.f("ix_api_tokens_team_id"), "api_tokens", ["team_id"], unique=False)
    op.create_table(
        "submissions",
        sa.Column("id", sa.Uuid(), nullable=False),
        sa.Column("team_id", sa.Uuid(), nullable=False),
        sa.Column(
            "kind",
            sa.String(length=16),
            nullable=False,
        ),
        sa.Column("track", sa.Text(), nullable=False),
        sa.Column("tasks", postgresql.ARRAY(sa.Text()), nullable=False),
        sa.Column("name", sa.String(length=128), nullable=False),
        sa.Column("digest", sa.String(length=64), nullable=False),
        sa.Column("archive_sha256", sa.String(length=64), nullable=False),
        sa.Column("archive_bytes", sa.BigInteger(), nullable=False),
        sa.Column("manifest", postgresql.JSONB(astext_type=sa.Text()), nullable=False),
        sa.Column("submitted_at", sa.DateTime(timezone=True), server_default=sa.text("now()"), nullable=False),
        sa.CheckConstraint("archive_sha256 ~ '^[0-9a-f]{64}$'", name=op.f("ck_submissions_archive_sha256_is_sha256")),
        sa.CheckConstraint("digest ~ '^[0-9a-f]{64}$'", name=op.f("ck_submissions_digest_is_sha256")),
        sa.CheckConstraint("archive_bytes > 0", name=op.f("ck_submissions_archive_is_not_empty")),
        sa.ForeignKeyConstraint(["team_id"], ["teams.id"], name=op.f("fk_submissions_team_id"), ondelete="RESTRICT"),
        sa.CheckConstraint("kind IN ('model', 'log', 'text_log')", name=op.f("ck_submissions_kind")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_submissions")),
        sa.UniqueConstraint(
            "team_id", "track", "kind", "digest", name=op.f("uq_submissions_team_id_track_kind_digest")
        ),
    )
    op.create_index(
        "ix_submissions_submitted_at_id",
        "submissions",
        [sa.literal_column("submitted_at DESC"), sa.literal_column("id DESC")],
        unique=False,
    )
    op.create_table(
        "evaluations",
        sa.Column("id", sa.Uuid(), nullable=False),
        sa.Column("submission_id", sa.Uuid(), nullable=False),
        sa.Column("run", sa.Integer(), nullable=False),
        sa.Column("evaluator_version", sa.Text(), nullable=False),
        sa.Column("evaluator_hash", sa.String(length=64), nullable=False),
        sa.Column("platform_class", sa.Text(), nullable=True),
        sa.Column(
            "state",
            sa.String(length=16),
            nullable=False,
        ),
        sa.Column("episodes_reused", sa.Integer(), nullable=False),
        sa.Column("created_at", sa.DateTime(timezone=True), server_default=sa.text("now()"), nullable=False),
        sa.Column("started_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("finished_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("verdict_code", sa.Text(), nullable=True),
        sa.Column("verdict_message", sa.Text(), nullable=True),
        sa.Column("verdict_task", sa.Text(), nullable=True),
        sa.Column("verdict_episode", sa.Integer(), nullable=True),
        sa.Column("log_tail", sa.Text(), nullable=False),
        sa.Column("scores", postgresql.JSONB(none_as_null=True, astext_type=sa.Text()), nullable=True),
        sa.Column("success_rate", sa.Float(), nullable=True),
        sa.Column("mean_steps", sa.Float(), nullable=True),
        sa.Column("result_hash", sa.String(length=64), nullable=True),
        sa.CheckConstraint(
            "(state = 'completed') = (result_hash IS NOT NULL AND scores IS NOT NULL AND success_rate IS NOT NULL)",
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
        sa.CheckConstraint("mean_steps > 0 AND mean_steps < 1e9", name=op.f("ck_evaluations_mean_steps_is_finite")),
        sa.CheckConstraint("run >= 1", name=op.f("ck_evaluations_run_counts_from_one")),
        sa.CheckConstraint(
            "success_rate >= 0 AND success_rate <= 1", name=op.f("ck_evaluations_success_rate_is_a_fraction")
        ),
        sa.ForeignKeyConstraint(
            ["submission_id"], ["submissions.id"], name=op.f("fk_evaluations_submission_id"), ondelete="RESTRICT"
        ),
        sa.CheckConstraint(
            "state IN ('queued', 'running', 'completed', 'failed', 'cancelled')", name=op.f("ck_evaluations_state")
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_evaluations")),
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
        "episode_results",
        sa.Column("id", sa.BigInteger(), sa.Identity(always=True), nullable=False),
        sa.Column("submission_digest", sa.String(length=64), nullable=False),
        sa.Column("evaluator_version", sa.Text(), nullable=False),
        sa.Column("track", sa.Text(), nullable=False),
        sa.Column("task", sa.Text(), nullable=False),
        sa.Column("episode", sa.Integer(), nullable=False),
        sa.Column("run", sa.Integer(), nullable=False),
        sa.Column("outcome", sa.Text(), nullable=False),
        sa.Column("success", sa.Boolean(), nullable=False),
        sa.Column("env_steps", sa.Integer(), nullable=False),
        sa.Column("record", postgresql.JSONB(astext_type=sa.Text()), nullable=False),
        sa.Column("record_digest", sa.String(length=64), nullable=False),
        sa.Column("wall_s", sa.Float(), nullable=False),
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
            "submission_digest", "evaluator_version", "track", "task", "episode", "run", name="uq_episode_results_key"
        ),
    )
    op.create_index(op.f("ix_episode_results_evaluation_id"), "episode_results", ["evaluation_id"], unique=False)
    op.create_index(
        "ix_episode_results_task_created_at",
        "episode_results",
        ["task", sa.literal_column("created_at DESC")],
        unique=False,
    )
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
        sa.Column("manifest", postgresql.JSONB(none_as_null=True, astext_type=sa.Text()), nullable=True),
        sa.Column("isolation", sa.Text(), nullable=True),
        sa.Column("lease_expires_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("queued_at", sa.DateTime(timezone=True), server_default=sa.text("now()"), nullable=False),
        sa.Column("started_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("finished_at", sa.DateTime(timezone=True), nullable=True),
        sa.CheckConstraint(
            "(state = 'running') <= (worker_id IS NOT NULL)", name=op.f("ck_shards_running_has_a_worker")
        ),
        sa.CheckConstraint(
            "(state = 'running') = (lease_expires_at IS NOT NULL)", name=op.f("ck_shards_running_has_a_lease")
        ),
        sa.CheckConstraint("attempts >= 0 AND token >= attempts", name=op.f("ck_shards_each_attempt_has_a_token")),
        sa.CheckConstraint("cardinality(episodes) > 0", name=op.f("ck_shards_has_episodes")),
        sa.CheckConstraint("(state = 'done') <= (manifest IS NOT NULL)", name=op.f("ck_shards_done_has_a_manifest")),
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


def downgrade() -> None:
    """Remove the tables with all their rows."""
    for table in reversed(TABLES):
        op.drop_table(table)
