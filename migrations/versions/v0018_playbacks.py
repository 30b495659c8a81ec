"""Playbacks of episodes, which workers make when somebody wants to see one."""

import sqlalchemy as sa
from alembic import op

revision = "0018"
down_revision = "0017"
branch_labels = None
depends_on = None

TRANSITIONS = (
    ("queued", "running"),
    ("queued", "failed"),
    ("running", "queued"),
    ("running", "made"),
    ("running", "failed"),
)


def upgrade() -> None:
    """Add the table, and the trigger that lets a state change only along its table of transitions."""
    op.create_table(
        "playbacks",
        sa.Column("id", sa.BigInteger(), sa.Identity(always=True), nullable=False),
        sa.Column("key", sa.String(length=64), nullable=False),
        sa.Column("episode_id", sa.BigInteger(), nullable=False),
        sa.Column("evaluator_version", sa.Text(), nullable=False),
        sa.Column("state", sa.String(length=16), nullable=False),
        sa.Column("asked_by", sa.Text(), nullable=False),
        sa.Column("asked_at", sa.DateTime(timezone=True), server_default=sa.func.now(), nullable=False),
        sa.Column("finished_at", sa.DateTime(timezone=True)),
        sa.Column("env_steps_played", sa.Integer(), nullable=False),
        sa.Column("token", sa.BigInteger(), nullable=False),
        sa.Column("attempts", sa.Integer(), nullable=False),
        sa.Column("lease_expires_at", sa.DateTime(timezone=True)),
        sa.Column("problem", sa.Text()),
        sa.Column("scene_sha256", sa.String(length=64)),
        sa.Column("cameras_sha256", sa.String(length=64)),
        sa.Column("still_sha256", sa.String(length=64)),
        sa.CheckConstraint("state IN ('queued', 'running', 'made', 'failed')", name=op.f("ck_playbacks_state")),
        *(
            sa.CheckConstraint(f"{column} ~ '^[0-9a-f]{{64}}$'", name=op.f(f"ck_playbacks_{column}_is_sha256"))
            for column in ("key", "scene_sha256", "cameras_sha256", "still_sha256")
        ),
        sa.CheckConstraint(
            "(state = 'running') = (lease_expires_at IS NOT NULL)", name=op.f("ck_playbacks_running_has_a_lease")
        ),
        sa.CheckConstraint("(state = 'made') = (scene_sha256 IS NOT NULL)", name=op.f("ck_playbacks_made_has_a_scene")),
        sa.CheckConstraint(
            "(state = 'failed') = (problem IS NOT NULL)", name=op.f("ck_playbacks_failed_has_a_problem")
        ),
        sa.CheckConstraint(
            "attempts >= 0 AND token >= attempts AND env_steps_played >= 0", name=op.f("ck_playbacks_counts_from_zero")
        ),
        sa.ForeignKeyConstraint(
            ["episode_id"], ["episode_results.id"], name=op.f("fk_playbacks_episode_id"), ondelete="CASCADE"
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_playbacks")),
        sa.UniqueConstraint("key", name=op.f("uq_playbacks_key")),
    )
    op.create_index("ix_playbacks_episode_id", "playbacks", ["episode_id"])
    op.create_index("ix_playbacks_asked_at", "playbacks", ["asked_at"])
    op.create_index("ix_playbacks_asked_by_asked_at", "playbacks", ["asked_by", "asked_at"])
    op.create_index(
        "ix_playbacks_open", "playbacks", ["state"], postgresql_where=sa.text("state IN ('queued', 'running')")
    )
    allowed = ", ".join(f"('{old}', '{new}')" for old, new in TRANSITIONS)
    op.execute(
        f"""
        CREATE FUNCTION check_playbacks_transition() RETURNS trigger LANGUAGE plpgsql AS $$
        BEGIN
            IF (OLD.state, NEW.state) NOT IN ({allowed}) THEN
                RAISE EXCEPTION 'playbacks % may not go from % to %', OLD.id, OLD.state, NEW.state
                    USING ERRCODE = 'check_violation', CONSTRAINT = 'ck_playbacks_transition';
            END IF;
            RETURN NEW;
        END $$
        """
    )
    op.execute(
        """
        CREATE TRIGGER playbacks_transition BEFORE UPDATE OF state ON playbacks FOR EACH ROW
        WHEN (OLD.state IS DISTINCT FROM NEW.state) EXECUTE FUNCTION check_playbacks_transition()
        """
    )


def downgrade() -> None:
    """Forget all playbacks; their files are removed as those of nobody."""
    op.drop_table("playbacks")
    op.execute("DROP FUNCTION check_playbacks_transition()")
