"""The competition, its stages' sealed lists and qualified teams; teams that are disqualified."""

import sqlalchemy as sa
from alembic import op
from sqlalchemy.dialects import postgresql

revision = "0019"
down_revision = "0018"
branch_labels = None
depends_on = None

EPISODE_KEY = ("submission_digest", "evaluator_version", "track", "task", "episode", "run")
RANKING = [sa.text(column) for column in ("success_rate DESC", "mean_steps", "submitted_at", "evaluation_id")]


def upgrade() -> None:
    """Everything from before belongs to no stage and was played on public lists."""
    _add_tables()
    op.add_column("teams", sa.Column("disqualified_at", sa.DateTime(timezone=True), nullable=True))
    op.add_column("teams", sa.Column("disqualified_for", sa.Text(), nullable=True))
    op.create_check_constraint(
        op.f("ck_teams_disqualified_for_a_reason"),
        "teams",
        "(disqualified_at IS NULL) = (disqualified_for IS NULL)",
    )
    for table, column in (("submissions", "stage"), ("board_results", "stage"), ("episode_results", "commitment")):
        op.add_column(table, sa.Column(column, sa.Text(), server_default="", nullable=False))
    op.add_column("evaluations", sa.Column("commitment", sa.String(length=64), nullable=True))
    op.create_foreign_key(
        op.f("fk_evaluations_commitment"),
        "evaluations",
        "sealed_lists",
        ["commitment"],
        ["commitment"],
        ondelete="RESTRICT",
    )
    op.add_column("board_results", sa.Column("finished_at", sa.DateTime(timezone=True), nullable=True))
    op.execute(
        "UPDATE board_results SET finished_at = evaluations.finished_at "
        "FROM evaluations WHERE evaluations.id = board_results.evaluation_id"
    )
    op.alter_column("board_results", "finished_at", nullable=False)
    _replace_keys(stage=("stage",), commitment=("commitment",))


def downgrade() -> None:
    """Forget the competition with everything that was played in its stages, which has no place without it."""
    op.execute(
        "DELETE FROM evaluations USING submissions WHERE submissions.id = submission_id AND submissions.stage <> ''"
    )
    op.execute("DELETE FROM board_results WHERE stage <> ''")
    op.execute("DELETE FROM submissions WHERE stage <> ''")
    op.execute("DELETE FROM episode_results WHERE commitment <> ''")
    _replace_keys(stage=(), commitment=())
    op.drop_column("board_results", "finished_at")
    op.drop_column("evaluations", "commitment")
    for table, column in (("submissions", "stage"), ("board_results", "stage"), ("episode_results", "commitment")):
        op.drop_column(table, column)
    op.drop_column("teams", "disqualified_for")
    op.drop_column("teams", "disqualified_at")
    for table in ("qualifications", "sealed_lists", "competition"):
        op.drop_table(table)


def _add_tables() -> None:
    op.create_table(
        "competition",
        sa.Column("id", sa.Integer(), server_default=sa.text("1"), autoincrement=False, nullable=False),
        sa.Column("definition", postgresql.JSONB(), nullable=False),
        sa.Column("applied_at", sa.DateTime(timezone=True), server_default=sa.func.now(), nullable=False),
        sa.Column("frozen_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("finalized_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("winners", postgresql.JSONB(), nullable=True),
        sa.CheckConstraint("id = 1", name=op.f("ck_competition_is_the_only_one")),
        sa.CheckConstraint("(finalized_at IS NULL) = (winners IS NULL)", name=op.f("ck_competition_final_has_winners")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_competition")),
    )
    op.create_table(
        "sealed_lists",
        sa.Column("commitment", sa.String(length=64), nullable=False),
        sa.Column("track", sa.Text(), nullable=False),
        sa.Column("stage", sa.Text(), nullable=False),
        sa.Column("secret", sa.String(length=64), nullable=False),
        sa.Column("made_at", sa.DateTime(timezone=True), server_default=sa.func.now(), nullable=False),
        sa.Column("revealed_at", sa.DateTime(timezone=True), nullable=True),
        sa.CheckConstraint("commitment ~ '^[0-9a-f]{64}$'", name=op.f("ck_sealed_lists_commitment_is_sha256")),
        sa.CheckConstraint("secret ~ '^[0-9a-f]{64}$'", name=op.f("ck_sealed_lists_secret_is_hexadecimal")),
        sa.PrimaryKeyConstraint("commitment", name=op.f("pk_sealed_lists")),
        sa.UniqueConstraint("track", "stage", name=op.f("uq_sealed_lists_track_stage")),
    )
    op.create_table(
        "qualifications",
        sa.Column("track", sa.Text(), nullable=False),
        sa.Column("stage", sa.Text(), nullable=False),
        sa.Column("team_id", sa.Uuid(), nullable=False),
        sa.Column("confirmed_at", sa.DateTime(timezone=True), server_default=sa.func.now(), nullable=False),
        sa.ForeignKeyConstraint(["team_id"], ["teams.id"], name=op.f("fk_qualifications_team_id"), ondelete="CASCADE"),
        sa.PrimaryKeyConstraint("track", "stage", "team_id", name=op.f("pk_qualifications")),
    )


def _replace_keys(*, stage: tuple[str, ...], commitment: tuple[str, ...]) -> None:
    """Make the keys of submissions and episodes and the indexes of boards anew, with or without the new columns."""
    op.execute("ALTER TABLE submissions DROP CONSTRAINT IF EXISTS uq_submissions_team_id_track_kind_digest")
    op.execute("ALTER TABLE submissions DROP CONSTRAINT IF EXISTS uq_submissions_team_id_track_stage_kind_digest")
    columns = ["team_id", "track", *stage, "kind", "digest"]
    op.create_unique_constraint(op.f(f"uq_submissions_{'_'.join(columns)}"), "submissions", columns)
    op.drop_constraint("uq_episode_results_key", "episode_results", type_="unique")
    op.create_unique_constraint("uq_episode_results_key", "episode_results", [*EPISODE_KEY, *commitment])
    for name, version in (("ix_board_results_of_version", ("evaluator_version",)), ("ix_board_results_of_team", ())):
        op.drop_index(name, "board_results")
        op.create_index(name, "board_results", ["track", *stage, "kind", "board", *version, "team_id", *RANKING])
