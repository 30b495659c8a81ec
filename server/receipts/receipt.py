"""What a receipt says and how it is signed; read by servers, workers and whoever checks one without a server.

Receipts make a chain: the link of each names the digest of the link before. A link tells nothing of the result but a
salted hash, so that all links are public while results of sealed lists and frozen boards are not.
"""

import hashlib
from datetime import datetime
from typing import Annotated, Literal
from uuid import UUID

from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey
from pydantic import Field, NonNegativeInt, PositiveInt
from vitac.envs.errors import VitacError
from vitac.evaluator.episodes.records import canonical_json
from vitac.evaluator.strict_model import StrictModel, Word
from vitac.evaluator.submission_kinds import SubmissionKind

_SIGNED = b"vitac-receipt-1\n"
"""Comes before what is signed, so that no signature of something else is one of a receipt."""
Sha256 = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
PublicKey = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
"""Of Ed25519 (RFC 8032): 32 bytes as hexadecimal digits."""
Rate = Annotated[float, Field(ge=0, le=1)]


class ReceiptRejected(VitacError):
    """A receipt is not what the service signed; the message says what differs."""


class TaskResult(StrictModel):
    """What a submission reached in one task."""

    task: Word
    episodes: PositiveInt
    successes: NonNegativeInt
    success_rate: Rate
    mean_steps: float | None
    result_hash: Sha256


class CombinedResult(StrictModel):
    """What it reached in all tasks that its track ranks together."""

    success_rate: Rate
    mean_steps: float | None


class Result(StrictModel):
    """The final result of one evaluation."""

    salt: Annotated[str, Field(pattern=r"^[0-9a-f]{32}$")]
    """Random, so that nobody finds the result by trying which one has the hash in the chain."""
    evaluation: UUID
    submission: UUID
    submission_digest: Sha256
    track: Word
    stage: str
    """Of the competition; empty outside of one."""
    kind: SubmissionKind
    run: PositiveInt
    evaluator_version: Word
    evaluator_hash: Sha256
    platform_class: Word
    commitment: Sha256 | None
    """Of the sealed list that was played; null: the public list of this evaluator version."""
    tasks: tuple[TaskResult, ...] = Field(min_length=1)
    combined: CombinedResult | None
    """Null for a log, and where no task counts."""
    result_hash: Sha256
    submitted_at: datetime
    finished_at: datetime
    issued_at: datetime

    def digest(self) -> str:
        """Return the SHA-256 [hex] by which the chain names this result."""
        return hashlib.sha256(canonical_json(self.model_dump(mode="json"))).hexdigest()


class Link(StrictModel):
    """One link of the chain; `previous` is the digest of the one before, null for the first."""

    number: PositiveInt
    previous: Sha256 | None
    result_sha256: Sha256
    public_key: PublicKey
    signature: Annotated[str, Field(pattern=r"^[0-9a-f]{128}$")]

    @property
    def digest(self) -> str:
        """SHA-256 [hex] over all but the signature."""
        return hashlib.sha256(
            _signed_bytes(self.number, self.previous, self.result_sha256, self.public_key)
        ).hexdigest()

    def require_signature(self) -> None:
        """Refuse a link that the holder of its key has not signed.

        Raises:
            ReceiptRejected: the signature is another one.
        """
        content = _signed_bytes(self.number, self.previous, self.result_sha256, self.public_key)
        try:
            key = Ed25519PublicKey.from_public_bytes(bytes.fromhex(self.public_key))
            key.verify(bytes.fromhex(self.signature), content)
        except (InvalidSignature, ValueError) as error:
            raise ReceiptRejected(
                f"Receipt {self.number} is not signed by {self.public_key}: something in it was changed."
            ) from error


class Receipt(StrictModel):
    """A link of the chain with the result that it stands for."""

    format: Literal["vitac-receipt-1"] = "vitac-receipt-1"
    link: Link
    result: Result

    def require_valid(self, public_key: str | None = None) -> None:
        """Refuse a receipt that is not whole, or not of that key.

        Args:
            public_key: of the service [hex]; None: whichever the receipt names.

        Raises:
            ReceiptRejected: it says what differs.
        """
        if self.result.digest() != self.link.result_sha256:
            raise ReceiptRejected(
                f"The result of receipt {self.link.number} was changed: expected SHA-256 {self.link.result_sha256}, "
                f"got {self.result.digest()}."
            )
        if public_key is not None and self.link.public_key != public_key:
            raise ReceiptRejected(
                f"Receipt {self.link.number} is of another service: expected the key {public_key}, got "
                f"{self.link.public_key}."
            )
        self.link.require_signature()


def sign(private_key: bytes, *, number: int, previous: str | None, result: Result) -> Receipt:
    """Return the receipt of a result.

    Args:
        private_key: 32 bytes.
        number: of the receipt, from 1.
        previous: digest of the link before; None for the first.
        result: what it says.
    """
    key = Ed25519PrivateKey.from_private_bytes(private_key)
    public_key = key.public_key().public_bytes_raw().hex()
    content = _signed_bytes(number, previous, result.digest(), public_key)
    link = Link(
        number=number,
        previous=previous,
        result_sha256=result.digest(),
        public_key=public_key,
        signature=key.sign(content).hex(),
    )
    return Receipt(link=link, result=result)


def _signed_bytes(number: int, previous: str | None, result_sha256: str, public_key: str) -> bytes:
    content = {"number": number, "previous": previous, "result_sha256": result_sha256, "public_key": public_key}
    return _SIGNED + canonical_json(content)
