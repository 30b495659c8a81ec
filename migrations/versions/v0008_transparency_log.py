"""Receipts become entries of a Merkle tree, in place of a chain of signatures; and what witnesses sign of it.

Receipts that were issued before are entries of the log, too; files of them that teams have hold signatures of the
former chain, and the page of the submission has them in the new form.

Revision 0008, after 0007.
"""

import hashlib
import json
from collections.abc import Iterator
from datetime import UTC, datetime
from typing import Any

import sqlalchemy as sa
from alembic import op

revision = "0008"
down_revision = "0007"
branch_labels = None
depends_on = None

APPEND_ONLY = ("tree_nodes", "cosignatures")
TILE_WIDTH = 256
FORMER_CHECKS = {
    "stands_for_something_known": "stands_for IN ('submission', 'result', 'end')",
    "only_the_first_has_none_before": "(number = 1) = (previous IS NULL)",
    "digest_is_sha256": "digest ~ '^[0-9a-f]{64}$'",
}
FORMER_COLUMNS = ("previous", "digest", "content_sha256", "issued_at", "public_key", "signature")


def upgrade() -> None:
    """Make the tables, and the entries of all receipts."""
    op.create_table(
        "tree_nodes",
        sa.Column("level", sa.SmallInteger(), autoincrement=False, nullable=False),
        sa.Column("number", sa.BigInteger(), autoincrement=False, nullable=False),
        sa.Column("hash", sa.LargeBinary(), nullable=False),
        sa.PrimaryKeyConstraint("level", "number", name="pk_tree_nodes"),
    )
    op.create_table(
        "cosignatures",
        sa.Column("witness", sa.Text(), nullable=False),
        sa.Column("size", sa.BigInteger(), autoincrement=False, nullable=False),
        sa.Column("signature", sa.LargeBinary(), nullable=False),
        sa.Column("signed_at", sa.DateTime(timezone=True), nullable=False),
        sa.PrimaryKeyConstraint("witness", "size", name="pk_cosignatures"),
    )
    op.add_column("receipts", sa.Column("entry", sa.Text(), nullable=True))
    op.add_column("receipts", sa.Column("leaf_hash", sa.LargeBinary(), nullable=True))
    op.execute("ALTER TABLE receipts DISABLE TRIGGER USER")
    _make_entries()
    op.execute("ALTER TABLE receipts ENABLE TRIGGER USER")
    _let_entries_follow("")
    for name in FORMER_CHECKS:
        op.drop_constraint(op.f(f"ck_receipts_{name}"), "receipts", type_="check")
    for name in FORMER_COLUMNS:
        op.drop_column("receipts", name)
    for name in ("entry", "leaf_hash"):
        op.alter_column("receipts", name, nullable=False)
    op.create_check_constraint(op.f("ck_receipts_leaf_hash_is_sha256"), "receipts", "octet_length(leaf_hash) = 32")
    for table in APPEND_ONLY:
        _refuse_changes(table)


def downgrade() -> None:
    """Remove the log with all receipts: nobody has the signatures of the former chain."""
    for table in APPEND_ONLY:
        op.drop_table(table)
        op.execute(f"DROP FUNCTION refuse_{table}_change()")
    op.execute("ALTER TABLE receipts DISABLE TRIGGER USER")
    op.execute("TRUNCATE receipts")
    op.execute("ALTER TABLE receipts ENABLE TRIGGER USER")
    op.drop_column("receipts", "entry")
    op.drop_column("receipts", "leaf_hash")
    op.add_column("receipts", sa.Column("previous", sa.String(64), nullable=True, unique=True))
    op.add_column("receipts", sa.Column("digest", sa.String(64), nullable=False, unique=True))
    op.add_column("receipts", sa.Column("content_sha256", sa.String(64), nullable=False))
    op.add_column("receipts", sa.Column("issued_at", sa.DateTime(timezone=True), nullable=False))
    op.add_column("receipts", sa.Column("public_key", sa.String(64), nullable=False))
    op.add_column("receipts", sa.Column("signature", sa.String(128), nullable=False))
    op.create_foreign_key("fk_receipts_previous", "receipts", "receipts", ["previous"], ["digest"], ondelete="RESTRICT")
    for name, rule in FORMER_CHECKS.items():
        op.create_check_constraint(op.f(f"ck_receipts_{name}"), "receipts", rule)
    _let_entries_follow("OR NEW.previous IS DISTINCT FROM (SELECT digest FROM receipts ORDER BY number DESC LIMIT 1)")


def _make_entries() -> None:
    connection = op.get_bind()
    receipts = sa.table("receipts", *map(sa.column, ("number", "entry", "leaf_hash")))
    change = receipts.update().where(receipts.c.number == sa.bindparam("at"))
    hashes = []
    rows = connection.execute(
        sa.text("SELECT number, stands_for, content_sha256, board, issued_at FROM receipts ORDER BY number")
    )
    for row in rows.mappings().all():
        entry = _write_entry(**row)
        hashes.append(hashlib.sha256(b"\0" + entry).digest())
        connection.execute(change, {"at": row["number"], "entry": entry.decode(), "leaf_hash": hashes[-1]})
    nodes = [{"level": level, "number": number, "hash": found} for level, number, found in _hash_tiles(hashes)]
    if nodes:
        op.bulk_insert(
            sa.table("tree_nodes", sa.column("level"), sa.column("number"), sa.column("hash", sa.LargeBinary())),
            nodes,
        )


def _write_entry(*, issued_at: datetime, stands_for: str, **values: Any) -> bytes:
    moment = issued_at.astimezone(UTC).isoformat().replace("+00:00", "Z")
    content = {**values, "content": stands_for, "issued_at": moment}
    return json.dumps(content, sort_keys=True, separators=(",", ":")).encode("ascii")


def _hash_tiles(hashes: list[bytes]) -> Iterator[tuple[int, int, bytes]]:
    """Yield level, number and hash of each node over a complete tile."""
    level = 0
    while len(hashes) >= TILE_WIDTH:
        level, below = level + 1, hashes
        hashes = [
            _hash_complete(below[end - TILE_WIDTH : end]) for end in range(TILE_WIDTH, len(below) + 1, TILE_WIDTH)
        ]
        yield from ((level, number, found) for number, found in enumerate(hashes))


def _hash_complete(hashes: list[bytes]) -> bytes:
    while len(hashes) > 1:
        pairs = zip(hashes[::2], hashes[1::2], strict=True)
        hashes = [hashlib.sha256(b"\1" + left + right).digest() for left, right in pairs]
    return hashes[0]


def _let_entries_follow(further: str) -> None:
    op.execute(
        f"""
        CREATE OR REPLACE FUNCTION refuse_receipt_gap() RETURNS trigger LANGUAGE plpgsql AS $$
        BEGIN
            IF NEW.number <> (SELECT coalesce(max(number), 0) + 1 FROM receipts) {further} THEN
                RAISE EXCEPTION 'receipt % does not follow the last one', NEW.number
                    USING ERRCODE = 'check_violation', CONSTRAINT = 'ck_receipts_without_gap';
            END IF;
            RETURN NEW;
        END $$
        """  # noqa: S608 - a text of our own
    )


def _refuse_changes(table: str) -> None:
    op.execute(
        f"""
        CREATE FUNCTION refuse_{table}_change() RETURNS trigger LANGUAGE plpgsql AS $$
        BEGIN
            RAISE EXCEPTION '{table} is append-only'
                USING ERRCODE = 'check_violation', CONSTRAINT = 'ck_{table}_append_only';
        END $$
        """
    )
    for name, event, each in (("append_only", "UPDATE OR DELETE", "ROW"), ("not_emptied", "TRUNCATE", "STATEMENT")):
        op.execute(
            f"CREATE TRIGGER {table}_{name} BEFORE {event} ON {table} FOR EACH {each} "
            f"EXECUTE FUNCTION refuse_{table}_change()"
        )
