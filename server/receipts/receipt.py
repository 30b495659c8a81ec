"""What a receipt says and how it is signed; read by servers, workers and whoever checks one without a server.

There is one for a submission when it arrives, one for each final result, and one for the end of a competition. They
make a chain: the link of each names the digest of the link before. A link shows nothing of its content but a salted
hash, so that all links are public while results of sealed lists and frozen boards are not.
"""

import hashlib
from datetime import datetime
from enum import StrEnum
from typing import Annotated, Any, ClassVar, Generic, Literal, TypeVar
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
"""Public key of Ed25519 (RFC 8032): 32 bytes as hexadecimal digits."""
ContentT = TypeVar("ContentT", bound="Content")
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


class LinkContent(StrEnum):
    """What a link of the chain stands for."""

    SUBMISSION = "submission"
    """A submission that has arrived."""
    RESULT = "result"
    """The final result of an evaluation."""
    END = "end"
    """The end of a competition: its winners."""


class Content(StrictModel):
    """What a receipt says."""

    stands_for: ClassVar[LinkContent]

    salt: Annotated[str, Field(pattern=r"^[0-9a-f]{32}$")]
    """Random, so that nobody finds the content by trying which one has the hash in the chain."""
    issued_at: datetime

    def digest(self) -> str:
        """Return the SHA-256 [hex] by which the chain names this content."""
        return hashlib.sha256(canonical_json(self.model_dump(mode="json"))).hexdigest()

    @property
    def board(self) -> str:
        """Where it belongs, as the chain names it."""
        raise NotImplementedError


class OfSubmission(Content):
    """What the receipts of a submission and of its results have in common."""

    submission: UUID
    submission_digest: Sha256
    contest: str
    """Name of the competition; empty outside of one."""
    track: Word
    stage: str
    """Stage of the competition; empty outside of one."""
    kind: SubmissionKind
    submitted_at: datetime
    team_sha256: Sha256
    """Hash of the name that the team had then, with the salt (`team_commitment`)."""

    @property
    def board(self) -> str:
        """The board on which the result may be, as the chain names it."""
        return board_name(self.contest, self.track, self.stage, self.kind)

    def is_of_team(self, name: str) -> bool:
        """Return whether the team had that name when the receipt was issued."""
        return self.team_sha256 == team_commitment(self.salt, name)


class Arrival(OfSubmission):
    """A submission that has arrived, before anybody knows its result."""

    stands_for = LinkContent.SUBMISSION


class Result(OfSubmission):
    """The final result of one evaluation."""

    stands_for = LinkContent.RESULT

    evaluation: UUID
    run: PositiveInt
    evaluator_version: Word
    evaluator_hash: Sha256
    platform_class: Word
    commitment: Sha256 | None
    """Commitment of the sealed list that was played; null for the public list of this evaluator version."""
    tasks: tuple[TaskResult, ...] = Field(min_length=1)
    combined: CombinedResult | None
    """Null for a log, and where no task counts."""
    result_hash: Sha256
    finished_at: datetime


class WinningEntry(StrictModel):
    """A place of the prize table, and the submission that wins it."""

    track: Word
    place: str
    rank: PositiveInt
    amount: NonNegativeInt
    currency: str
    submission: UUID
    result_hash: Sha256
    total: float | None


class JudgedEntry(StrictModel):
    """What the judges think of a submission: the mean of their marks by criterion, and its total."""

    track: Word
    submission: UUID
    criteria: dict[str, float]
    total: float | None


class End(Content):
    """The end of a competition; signed again where its winners are decided again, or it is reopened."""

    stands_for = LinkContent.END

    contest: str
    """Name of the competition."""
    finalized_at: datetime | None
    """Null: the competition was reopened, and there are no winners."""
    reason: str | None
    """Why it was reopened."""
    winners: tuple[WinningEntry, ...]
    judged: tuple[JudgedEntry, ...]

    @property
    def board(self) -> str:
        """Which competition it ends, as the chain names it."""
        return end_name(self.contest)


def team_commitment(salt: str, name: str) -> str:
    """Return the SHA-256 [hex] by which a receipt names a team: its name cannot be read from it, only compared."""
    return hashlib.sha256(canonical_json({"salt": salt, "team": name})).hexdigest()


def end_name(contest: str) -> str:
    """Return how the chain names the end of a competition."""
    return f"end of {contest}"


def board_name(contest: str, track: str, stage: str, kind: SubmissionKind) -> str:
    """Return how the chain names the boards of a stage: those of all tasks together and of each one."""
    return f"{contest}/{track}/{stage}/{kind}"


class Link(StrictModel):
    """One link of the chain; `previous` is the digest of the one before, null for the first."""

    number: PositiveInt
    previous: Sha256 | None
    content: LinkContent
    content_sha256: Sha256
    board: Annotated[str, Field(max_length=300)]
    """Competition, track, stage and kind (`board_name`), so that nothing of a board can be left out of an export."""
    issued_at: datetime
    """Never before that of the link before."""
    public_key: PublicKey
    signature: Annotated[str, Field(pattern=r"^[0-9a-f]{128}$")]

    @property
    def digest(self) -> str:
        """SHA-256 [hex] over all but the signature."""
        return hashlib.sha256(self.signed_bytes()).hexdigest()

    def require_signature(self) -> None:
        """Refuse a link that the holder of its key has not signed.

        Raises:
            ReceiptRejected: the signature is another one.
        """
        try:
            key = Ed25519PublicKey.from_public_bytes(bytes.fromhex(self.public_key))
            key.verify(bytes.fromhex(self.signature), self.signed_bytes())
        except (InvalidSignature, ValueError) as error:
            raise ReceiptRejected(
                f"Receipt {self.number} is not signed by {self.public_key}: something in it was changed."
            ) from error

    def signed_bytes(self) -> bytes:
        """Return what the signature covers."""
        return _SIGNED + canonical_json(self.model_dump(mode="json", exclude={"signature"}))


class SignedContent(StrictModel, Generic[ContentT]):
    """A link of the chain with the content that it stands for."""

    format: Literal["vitac-receipt-1"] = "vitac-receipt-1"
    link: Link

    @property
    def content(self) -> ContentT:
        """What was signed."""
        raise NotImplementedError

    def require_valid(self, public_key: str | None = None) -> None:
        """Refuse a receipt that is not whole, or not of that key.

        Args:
            public_key: of the service [hex]; None: whichever the receipt names.

        Raises:
            ReceiptRejected: it says what differs.
        """
        found = _link_content(self.content)
        if found["content_sha256"] != self.link.content_sha256:
            raise ReceiptRejected(
                f"The {self.link.content} of receipt {self.link.number} was changed: expected SHA-256 "
                f"{self.link.content_sha256}, got {found['content_sha256']}."
            )
        for name, value in found.items():
            if value != getattr(self.link, name):
                raise ReceiptRejected(
                    f"Receipt {self.link.number} has another {name} than its link: expected {value}, got "
                    f"{getattr(self.link, name)}."
                )
        if public_key is not None and self.link.public_key != public_key:
            raise ReceiptRejected(
                f"Receipt {self.link.number} is of another service: expected the key {public_key}, got "
                f"{self.link.public_key}."
            )
        self.link.require_signature()


class SubmissionReceipt(SignedContent[Arrival]):
    """The receipt of a submission that has arrived."""

    submission: Arrival

    @property
    def content(self) -> Arrival:
        """What was signed."""
        return self.submission


class Receipt(SignedContent[Result]):
    """The receipt of a final result."""

    result: Result

    @property
    def content(self) -> Result:
        """What was signed."""
        return self.result


class EndReceipt(SignedContent[End]):
    """The receipt of the end of a competition."""

    end: End

    @property
    def content(self) -> End:
        """What was signed."""
        return self.end


AnyReceipt = SubmissionReceipt | Receipt | EndReceipt


def parse_receipt(link: Link, content: str) -> AnyReceipt:
    """Return the receipt of a link and its content as JSON text."""
    match link.content:
        case LinkContent.SUBMISSION:
            return SubmissionReceipt(link=link, submission=Arrival.model_validate_json(content))
        case LinkContent.RESULT:
            return Receipt(link=link, result=Result.model_validate_json(content))
        case LinkContent.END:
            return EndReceipt(link=link, end=End.model_validate_json(content))


def sign(private_key: bytes, *, number: int, previous: str | None, content: Content) -> Link:
    """Return the link of a content.

    Args:
        private_key: 32 bytes.
        number: of the receipt, from 1.
        previous: digest of the link before; None for the first.
        content: what it says.
    """
    key = Ed25519PrivateKey.from_private_bytes(private_key)
    unsigned = Link(
        number=number,
        previous=previous,
        public_key=key.public_key().public_bytes_raw().hex(),
        signature="0" * 128,
        **_link_content(content),
    )
    return unsigned.model_copy(update={"signature": key.sign(unsigned.signed_bytes()).hex()})


def _link_content(content: Content) -> dict[str, Any]:
    """Return what a link says of its content."""
    return {
        "content": content.stands_for,
        "content_sha256": content.digest(),
        "board": content.board,
        "issued_at": content.issued_at,
    }
