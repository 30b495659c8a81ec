"""What a receipt says and how it is signed; read by servers, workers and whoever checks one without a server.

Receipts make a chain: the link of each names the digest of the link before. A link tells nothing of the result but a
salted hash, so that all links are public while results of sealed lists and frozen boards are not.
"""

import hashlib
from datetime import datetime
from typing import Annotated, Literal, Self
from uuid import UUID

from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey
from pydantic import Field, NonNegativeInt, PositiveInt, model_validator
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
    team_sha256: Sha256 | None = None
    """Of the name that the team had then, with the salt (`team_commitment`); null in a receipt of the first format."""

    def digest(self) -> str:
        """Return the SHA-256 [hex] by which the chain names this result."""
        without = {"team_sha256"} if self.team_sha256 is None else None
        return hashlib.sha256(canonical_json(self.model_dump(mode="json", exclude=without))).hexdigest()

    @property
    def board(self) -> str:
        """On which board the result may be, as the chain names it."""
        return board_name(self.track, self.stage, self.kind)

    def is_of_team(self, name: str) -> bool:
        """Return whether the team had that name when the receipt was issued; False where the receipt names no team."""
        return self.team_sha256 == team_commitment(self.salt, name)


def team_commitment(salt: str, name: str) -> str:
    """Return the SHA-256 [hex] by which a receipt names a team: its name cannot be read from it, only compared."""
    return hashlib.sha256(canonical_json({"salt": salt, "team": name})).hexdigest()


def board_name(track: str, stage: str, kind: SubmissionKind) -> str:
    """Return how the chain names the boards of a stage: those of all tasks together and of each one."""
    return f"{track}/{stage}/{kind}"


class Link(StrictModel):
    """One link of the chain; `previous` is the digest of the one before, null for the first."""

    number: PositiveInt
    previous: Sha256 | None
    result_sha256: Sha256
    public_key: PublicKey
    signature: Annotated[str, Field(pattern=r"^[0-9a-f]{128}$")]
    board: Annotated[str, Field(max_length=300)] | None = None
    """Track, stage and kind (`board_name`), so that nothing of a board can be left out of an export unseen; null in a
    link of the first format."""

    @property
    def digest(self) -> str:
        """SHA-256 [hex] over all but the signature."""
        return hashlib.sha256(self._signed_bytes()).hexdigest()

    def require_signature(self) -> None:
        """Refuse a link that the holder of its key has not signed.

        Raises:
            ReceiptRejected: the signature is another one.
        """
        try:
            key = Ed25519PublicKey.from_public_bytes(bytes.fromhex(self.public_key))
            key.verify(bytes.fromhex(self.signature), self._signed_bytes())
        except (InvalidSignature, ValueError) as error:
            raise ReceiptRejected(
                f"Receipt {self.number} is not signed by {self.public_key}: something in it was changed."
            ) from error

    def _signed_bytes(self) -> bytes:
        return _signed_bytes(self.number, self.previous, self.result_sha256, self.public_key, self.board)


class Receipt(StrictModel):
    """A link of the chain with the result that it stands for."""

    format: Literal["vitac-receipt-1", "vitac-receipt-2"] = "vitac-receipt-2"
    """The first one names neither team nor board."""
    link: Link
    result: Result

    @classmethod
    def of(cls, link: Link, result: Result) -> Self:
        """Return the receipt of a link and its result, in the format in which it was issued."""
        return cls(format="vitac-receipt-1" if link.board is None else "vitac-receipt-2", link=link, result=result)

    @model_validator(mode="after")
    def _is_of_one_format(self) -> Self:
        names_both = {
            self.format == "vitac-receipt-2",
            self.link.board is not None,
            self.result.team_sha256 is not None,
        }
        if len(names_both) > 1:
            raise ValueError(f"expected team and board in vitac-receipt-2 and neither before, got {self.format}")
        return self

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
        if self.link.board not in {None, self.result.board}:
            raise ReceiptRejected(
                f"Receipt {self.link.number} is of another board: expected {self.result.board}, got {self.link.board}."
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
        result: what it says; one without a team makes a receipt of the first format.
    """
    key = Ed25519PrivateKey.from_private_bytes(private_key)
    public_key = key.public_key().public_bytes_raw().hex()
    board = None if result.team_sha256 is None else result.board
    content = _signed_bytes(number, previous, result.digest(), public_key, board)
    link = Link(
        number=number,
        previous=previous,
        result_sha256=result.digest(),
        public_key=public_key,
        signature=key.sign(content).hex(),
        board=board,
    )
    return Receipt.of(link, result)


def _signed_bytes(number: int, previous: str | None, result_sha256: str, public_key: str, board: str | None) -> bytes:
    content = {"number": number, "previous": previous, "result_sha256": result_sha256, "public_key": public_key}
    return _SIGNED + canonical_json(content if board is None else content | {"board": board})
