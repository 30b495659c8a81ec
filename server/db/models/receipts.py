"""Receipts of final results, a chain to which rows are only added, and the key that signs them."""

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
        result: as the JSON text that is hashed.
        board: on which the result may be; NULL in a receipt of the first format.
    """

    __tablename__ = "receipts"
    __table_args__ = (
        CheckConstraint("number >= 1", name="counts_from_one"),
        CheckConstraint("(number = 1) = (previous IS NULL)", name="only_the_first_has_none_before"),
        sha256_check("digest"),
    )
    number: Mapped[int] = mapped_column(BigInteger, primary_key=True, autoincrement=False)
    evaluation_id: Mapped[UUID] = mapped_column(ForeignKey("evaluations.id", ondelete="RESTRICT"), unique=True)
    previous: Mapped[str | None] = mapped_column(
        String(64), ForeignKey("receipts.digest", ondelete="RESTRICT"), unique=True
    )
    digest: Mapped[str] = mapped_column(String(64), unique=True)
    result: Mapped[str]
    result_sha256: Mapped[str] = mapped_column(String(64))
    public_key: Mapped[str] = mapped_column(String(64))
    signature: Mapped[str] = mapped_column(String(128))
    board: Mapped[str | None] = mapped_column(index=True)
