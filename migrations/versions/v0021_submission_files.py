"""Stored files of a submission besides its upload: a sensor as it is scored, a design document, coefficients."""

import sqlalchemy as sa
from alembic import op
from sqlalchemy.dialects import postgresql

revision = "0021"
down_revision = "0020"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Add the table."""
    op.create_table(
        "submission_files",
        sa.Column("submission_id", sa.Uuid(), nullable=False),
        sa.Column("role", sa.String(length=16), nullable=False),
        sa.Column("sha256", sa.String(length=64), nullable=False),
        sa.Column("n_bytes", sa.BigInteger(), nullable=False),
        sa.Column("name", sa.String(length=128), nullable=False),
        sa.Column("facts", postgresql.JSONB(), nullable=False),
        sa.CheckConstraint("role IN ('sensor', 'document', 'coefficients')", name=op.f("ck_submission_files_role")),
        sa.CheckConstraint("sha256 ~ '^[0-9a-f]{64}$'", name=op.f("ck_submission_files_sha256_is_sha256")),
        sa.CheckConstraint("n_bytes > 0", name=op.f("ck_submission_files_is_not_empty")),
        sa.ForeignKeyConstraint(
            ["submission_id"], ["submissions.id"], name=op.f("fk_submission_files_submission_id"), ondelete="CASCADE"
        ),
        sa.PrimaryKeyConstraint("submission_id", "role", "sha256", name=op.f("pk_submission_files")),
    )


def downgrade() -> None:
    """Remove it; the stored files are removed by housekeeping."""
    op.drop_table("submission_files")
