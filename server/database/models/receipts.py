"""The log of receipts, to which rows are only added, what witnesses sign of it, and the key that signs it."""

from datetime import datetime
from uuid import UUID

from sqlalchemy import BigInteger, CheckConstraint, ForeignKey, LargeBinary, SmallInteger, String, func, text
from sqlalchemy.orm import Mapped, mapped_column

from .base import Base


class ReceiptKey(Base):
    """The one key of this service (Ed25519, hexadecimal digits). It stays with the database, also in a backup."""

    __tablename__ = "receipt_key"
    __table_args__ = (
        CheckConstraint("id = 1", name="is_the_only_one"),
        CheckConstraint("private_key ~ '^[0-9a-f]{64}$'", name="private_key_is_hexadecimal"),
    )
    id: Mapped[int] = mapped_column(primary_key=True, autoincrement=False, default=1, server_default=text("1"))
    private_key: Mapped[str] = mapped_column(String(64))
    public_key: Mapped[str] = mapped_column(String(64))
    made_at: Mapped[datetime] = mapped_column(server_default=func.now())


class ReceiptRow(Base):
    """A receipt and its entry of the log; triggers refuse to change one, to take one away and to leave a gap.

    Attributes:
        stands_for: `EntryKind`.
        entry: the bytes of the entry, as everybody reads them.
        leaf_hash: of these bytes, in the tree.
        content: what the receipt says, as JSON text.
        submission_id: of the submission that arrived; NULL otherwise.
        evaluation_id: of the evaluation whose result it is; NULL otherwise.
        board: on which the result may be.
    """

    __tablename__ = "receipts"
    __table_args__ = (
        CheckConstraint("number >= 1", name="counts_from_one"),
        CheckConstraint("(stands_for = 'submission') = (submission_id IS NOT NULL)", name="arrival_has_submission"),
        CheckConstraint("(stands_for = 'result') = (evaluation_id IS NOT NULL)", name="result_has_evaluation"),
        CheckConstraint("octet_length(leaf_hash) = 32", name="leaf_hash_is_sha256"),
    )
    number: Mapped[int] = mapped_column(BigInteger, primary_key=True, autoincrement=False)
    submission_id: Mapped[UUID | None] = mapped_column(ForeignKey("submissions.id", ondelete="RESTRICT"), unique=True)
    evaluation_id: Mapped[UUID | None] = mapped_column(ForeignKey("evaluations.id", ondelete="RESTRICT"), unique=True)
    stands_for: Mapped[str]
    content: Mapped[str]
    board: Mapped[str] = mapped_column(index=True)
    entry: Mapped[str]
    leaf_hash: Mapped[bytes] = mapped_column(LargeBinary)


class TreeNode(Base):
    """The hash over a complete tile of the log's tree, in a tile of the level above (`server.transparency.merkle`)."""

    __tablename__ = "tree_nodes"
    level: Mapped[int] = mapped_column(SmallInteger, primary_key=True, autoincrement=False)
    number: Mapped[int] = mapped_column(BigInteger, primary_key=True, autoincrement=False)
    hash: Mapped[bytes] = mapped_column(LargeBinary)


class Cosignature(Base):
    """What a witness signed of a checkpoint.

    Attributes:
        witness: its verifier key.
        size: of the checkpoint.
        signature: time and Ed25519 signature, as in a line of a note.
        signed_at: as the witness says.
    """

    __tablename__ = "cosignatures"
    witness: Mapped[str] = mapped_column(primary_key=True)
    size: Mapped[int] = mapped_column(BigInteger, primary_key=True, autoincrement=False)
    signature: Mapped[bytes] = mapped_column(LargeBinary)
    signed_at: Mapped[datetime]
