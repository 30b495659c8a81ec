"""Receipts of submissions and final results, a chain to which rows are only added, and the key that signs them."""

from datetime import datetime
from uuid import UUID

from sqlalchemy import BigInteger, CheckConstraint, ForeignKey, String, func, text
from sqlalchemy.orm import Mapped, mapped_column

from .base import Base, sha256_check


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
    """A receipt (`server.receipts.receipt`); triggers refuse to change one, to take one away and to leave a gap.

    Attributes:
        digest: of its link.
        previous: digest of the link before; NULL for the first.
        stands_for: `LinkContent`: a submission that arrived, a result, or the end of a competition.
        content: what it says, as JSON text.
        submission_id: of the submission that arrived; NULL otherwise.
        evaluation_id: of the evaluation whose result it is; NULL otherwise.
        board: on which the result may be.
    """

    __tablename__ = "receipts"
    __table_args__ = (
        CheckConstraint("number >= 1", name="counts_from_one"),
        CheckConstraint("(number = 1) = (previous IS NULL)", name="only_the_first_has_none_before"),
        CheckConstraint("stands_for IN ('submission', 'result', 'end')", name="stands_for_something_known"),
        CheckConstraint("(stands_for = 'submission') = (submission_id IS NOT NULL)", name="arrival_has_submission"),
        CheckConstraint("(stands_for = 'result') = (evaluation_id IS NOT NULL)", name="result_has_evaluation"),
        sha256_check("digest"),
    )
    number: Mapped[int] = mapped_column(BigInteger, primary_key=True, autoincrement=False)
    submission_id: Mapped[UUID | None] = mapped_column(ForeignKey("submissions.id", ondelete="RESTRICT"), unique=True)
    evaluation_id: Mapped[UUID | None] = mapped_column(ForeignKey("evaluations.id", ondelete="RESTRICT"), unique=True)
    previous: Mapped[str | None] = mapped_column(
        String(64), ForeignKey("receipts.digest", ondelete="RESTRICT"), unique=True
    )
    digest: Mapped[str] = mapped_column(String(64), unique=True)
    stands_for: Mapped[str]
    content: Mapped[str]
    content_sha256: Mapped[str] = mapped_column(String(64))
    issued_at: Mapped[datetime]
    public_key: Mapped[str] = mapped_column(String(64))
    signature: Mapped[str] = mapped_column(String(128))
    board: Mapped[str] = mapped_column(index=True)
