"""Films of ManiSkill's episodes, which have no scene in 3D."""

import sqlalchemy as sa
from alembic import op

revision = "0039"
down_revision = "0038"
branch_labels = None
depends_on = None

_SCENE, _EITHER = "ck_playbacks_made_has_a_scene", "ck_playbacks_made_has_scene_or_film"


def upgrade() -> None:
    """Let a made playback have a film in place of a scene."""
    op.add_column("playbacks", sa.Column("film_sha256", sa.String(length=64)))
    op.create_check_constraint(
        op.f("ck_playbacks_film_sha256_is_sha256"), "playbacks", "film_sha256 ~ '^[0-9a-f]{64}$'"
    )
    op.drop_constraint(op.f(_SCENE), "playbacks")
    op.create_check_constraint(
        op.f(_EITHER), "playbacks", "(state = 'made') = (scene_sha256 IS NOT NULL OR film_sha256 IS NOT NULL)"
    )


def downgrade() -> None:
    """Forget playbacks that are films; they are made again when somebody asks."""
    op.execute("DELETE FROM playbacks WHERE film_sha256 IS NOT NULL")
    op.drop_constraint(op.f(_EITHER), "playbacks")
    op.drop_column("playbacks", "film_sha256")
    op.create_check_constraint(op.f(_SCENE), "playbacks", "(state = 'made') = (scene_sha256 IS NOT NULL)")
