"""Receipts of final results, the chain that they make, and the key that signs them."""

import sqlalchemy as sa
from alembic import op

revision = "0023"
down_revision = "0022"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Add the tables, and triggers that keep the chain whole."""
    op.create_table(
        "receipt_key",
        sa.Column("id", sa.Integer(), server_default=sa.text("1"), autoincrement=False, nullable=False),
        sa.Column("private_key", sa.String(length=64), nullable=False),
        sa.Column("public_key", sa.String(length=64), nullable=False),
        sa.Column("made_at", sa.DateTime(timezone=True), server_default=sa.func.now(), nullable=False),
        sa.CheckConstraint("id = 1", name=op.f("ck_receipt_key_is_the_only_one")),
        sa.CheckConstraint("private_key ~ '^[0-9a-f]{64}$'", name=op.f("ck_receipt_key_private_key_is_hexadecimal")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_receipt_key")),
    )
    op.create_table(
        "receipts",
        sa.Column("number", sa.BigInteger(), autoincrement=False, nullable=False),
        sa.Column("evaluation_id", sa.Uuid(), nullable=False),
        sa.Column("previous", sa.String(length=64), nullable=True),
        sa.Column("digest", sa.String(length=64), nullable=False),
        sa.Column("result", sa.Text(), nullable=False),
        sa.Column("result_sha256", sa.String(length=64), nullable=False),
        sa.Column("public_key", sa.String(length=64), nullable=False),
        sa.Column("signature", sa.String(length=128), nullable=False),
        sa.CheckConstraint("number >= 1", name=op.f("ck_receipts_counts_from_one")),
        sa.CheckConstraint(
            "(number = 1) = (previous IS NULL)", name=op.f("ck_receipts_only_the_first_has_none_before")
        ),
        sa.CheckConstraint("digest ~ '^[0-9a-f]{64}$'", name=op.f("ck_receipts_digest_is_sha256")),
        sa.PrimaryKeyConstraint("number", name=op.f("pk_receipts")),
        sa.UniqueConstraint("digest", name=op.f("uq_receipts_digest")),
        sa.UniqueConstraint("evaluation_id", name=op.f("uq_receipts_evaluation_id")),
        sa.UniqueConstraint("previous", name=op.f("uq_receipts_previous")),
        sa.ForeignKeyConstraint(
            ["evaluation_id"], ["evaluations.id"], name=op.f("fk_receipts_evaluation_id"), ondelete="RESTRICT"
        ),
        sa.ForeignKeyConstraint(
            ["previous"], ["receipts.digest"], name=op.f("fk_receipts_previous"), ondelete="RESTRICT"
        ),
    )
    op.execute(
        """
        CREATE FUNCTION refuse_receipt_change() RETURNS trigger LANGUAGE plpgsql AS $$
        BEGIN
            RAISE EXCEPTION 'receipts are append-only'
                USING ERRCODE = 'check_violation', CONSTRAINT = 'ck_receipts_append_only';
        END $$
        """
    )
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
    for name, event, each, function in (
        ("append_only", "UPDATE OR DELETE", "ROW", "change"),
        ("not_emptied", "TRUNCATE", "STATEMENT", "change"),
        ("without_gap", "INSERT", "ROW", "gap"),
    ):
        op.execute(
            f"CREATE TRIGGER receipts_{name} BEFORE {event} ON receipts "
            f"FOR EACH {each} EXECUTE FUNCTION refuse_receipt_{function}()"
        )


def downgrade() -> None:
    """Forget receipts and key."""
    for table in ("receipts", "receipt_key"):
        op.drop_table(table)
    for name in ("change", "gap"):
        op.execute(f"DROP FUNCTION refuse_receipt_{name}()")
