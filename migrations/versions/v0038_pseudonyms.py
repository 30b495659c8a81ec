"""A random name for each team, under which others see it until an anonymous competition is final."""

import sqlalchemy as sa
from alembic import op

revision = "0038"
down_revision = "0037"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Give one to every team: the default is computed for each row, also of teams that are added later."""
    made = sa.text("'Team ' || upper(substr(md5(gen_random_uuid()::text), 1, 10))")
    op.add_column("teams", sa.Column("pseudonym", sa.String(length=64), server_default=made, nullable=False))


def downgrade() -> None:
    """Forget them."""
    op.drop_column("teams", "pseudonym")
