"""Members of teams with roles, invitations, tokens and sessions of members, approval and merging of teams."""

import sqlalchemy as sa
from alembic import op

revision = "0025"
down_revision = "0024"
branch_labels = None
depends_on = None

CONTENT = ["team_id", "track", "stage", "kind", "digest"]


def upgrade() -> None:
    """Make a captain for each team, whose tokens stay as they are; all teams from before are accepted."""
    op.add_column("teams", sa.Column("approved_at", sa.DateTime(timezone=True), nullable=True))
    op.add_column("teams", sa.Column("refused_for", sa.Text(), nullable=True))
    op.add_column(
        "teams", sa.Column("named_at", sa.DateTime(timezone=True), server_default=sa.func.now(), nullable=False)
    )
    op.execute("UPDATE teams SET approved_at = created_at, named_at = created_at")
    op.create_check_constraint(
        op.f("ck_teams_is_accepted_or_refused"), "teams", "approved_at IS NULL OR refused_for IS NULL"
    )
    _add_tables()
    op.execute(
        "INSERT INTO members (id, team_id, role, name, name_key, joined_at) "
        "SELECT gen_random_uuid(), id, 'captain', 'Captain', 'captain', created_at FROM teams"
    )
    _change_tokens()
    op.add_column("submissions", sa.Column("merged_from", sa.Uuid(), nullable=True))
    op.drop_constraint(f"uq_submissions_{'_'.join(CONTENT)}", "submissions", type_="unique")
    op.create_index(
        "uq_submissions_content", "submissions", CONTENT, unique=True, postgresql_where=sa.text("merged_from IS NULL")
    )


def downgrade() -> None:
    """Forget members with their tokens; of equal submissions of merged teams, those of the team that is left stay."""
    op.execute(
        "DELETE FROM evaluations USING submissions WHERE submissions.id = submission_id AND merged_from IS NOT NULL"
    )
    op.execute("DELETE FROM submissions WHERE merged_from IS NOT NULL")
    op.drop_index("uq_submissions_content", "submissions")
    op.drop_column("submissions", "merged_from")
    op.create_unique_constraint(op.f(f"uq_submissions_{'_'.join(CONTENT)}"), "submissions", CONTENT)
    op.execute("DELETE FROM api_tokens WHERE member_id IS NOT NULL")
    for column in ("member_id", "is_session"):
        op.drop_column("api_tokens", column)
    op.drop_table("invitations")
    op.drop_table("members")
    for column in ("named_at", "refused_for", "approved_at"):
        op.drop_column("teams", column)


def _add_tables() -> None:
    op.create_table(
        "members",
        sa.Column("id", sa.Uuid(), nullable=False),
        sa.Column("team_id", sa.Uuid(), nullable=False),
        sa.Column("role", sa.String(length=16), nullable=False),
        sa.Column("name", sa.String(length=64), nullable=False),
        sa.Column("name_key", sa.String(length=64), nullable=False),
        sa.Column("email", sa.String(length=254), nullable=True),
        sa.Column("password_hash", sa.Text(), nullable=True),
        sa.Column("joined_at", sa.DateTime(timezone=True), server_default=sa.func.now(), nullable=False),
        sa.Column("left_at", sa.DateTime(timezone=True), nullable=True),
        sa.CheckConstraint("role IN ('captain', 'member')", name=op.f("ck_members_role")),
        sa.CheckConstraint(
            "left_at IS NULL OR (password_hash IS NULL AND email IS NULL)",
            name=op.f("ck_members_who_has_left_has_no_password"),
        ),
        sa.ForeignKeyConstraint(["team_id"], ["teams.id"], name=op.f("fk_members_team_id"), ondelete="CASCADE"),
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
        "invitations",
        sa.Column("id", sa.Uuid(), nullable=False),
        sa.Column("team_id", sa.Uuid(), nullable=False),
        sa.Column("code_sha256", sa.String(length=64), nullable=False),
        sa.Column("created_at", sa.DateTime(timezone=True), server_default=sa.func.now(), nullable=False),
        sa.Column("expires_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("used_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("revoked_at", sa.DateTime(timezone=True), nullable=True),
        sa.CheckConstraint("length(code_sha256) = 64", name=op.f("ck_invitations_code_is_hashed")),
        sa.CheckConstraint("used_at IS NULL OR revoked_at IS NULL", name=op.f("ck_invitations_is_used_or_revoked")),
        sa.ForeignKeyConstraint(["team_id"], ["teams.id"], name=op.f("fk_invitations_team_id"), ondelete="CASCADE"),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_invitations")),
        sa.UniqueConstraint("code_sha256", name=op.f("uq_invitations_code_sha256")),
    )
    op.create_index(op.f("ix_invitations_team_id"), "invitations", ["team_id"])


def _change_tokens() -> None:
    op.add_column("api_tokens", sa.Column("member_id", sa.Uuid(), nullable=True))
    op.add_column("api_tokens", sa.Column("is_session", sa.Boolean(), server_default=sa.false(), nullable=False))
    op.create_foreign_key(
        op.f("fk_api_tokens_member_id"), "api_tokens", "members", ["member_id"], ["id"], ondelete="CASCADE"
    )
    op.create_index(op.f("ix_api_tokens_member_id"), "api_tokens", ["member_id"])
    op.create_index(
        "uq_api_tokens_of_member",
        "api_tokens",
        ["member_id"],
        unique=True,
        postgresql_where=sa.text("revoked_at IS NULL AND NOT is_session"),
    )
    for name, condition in (
        ("members_have_a_team", "member_id IS NULL OR team_id IS NOT NULL"),
        ("sessions_have_a_member", "NOT is_session OR member_id IS NOT NULL"),
    ):
        op.create_check_constraint(op.f(f"ck_api_tokens_{name}"), "api_tokens", condition)
