"""What a receipt says and how it is signed; read by servers, workers and whoever checks one without a server.

There is one for a submission when it arrives, one for each final result, and one for the end of a competition. Each
is an entry of the log (`server.transparency`), whose checkpoints are signed.
"""

import hashlib
from collections.abc import Iterable, Mapping
from datetime import UTC, datetime
from types import MappingProxyType
from typing import Annotated, Generic, Literal, TypeVar
from uuid import UUID

from pydantic import Field, NonNegativeInt, PositiveInt
from vitac.errors import VitacError
from vitac.evaluator.episodes.records import canonical_json
from vitac.evaluator.strict_model import StrictModel, Word
from vitac.evaluator.submission_kinds import SubmissionKind

from ..transparency.entries import Content, EntryKind, LogEntry, Sha256
from ..transparency.merkle import ProofRejected
from ..transparency.notes import MAX_NOTE_CHARS, InclusionProof, NoteRejected, VerifierKey, make_log_key

PublicKey = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
"""Public key of Ed25519 (RFC 8032): 32 bytes as hexadecimal digits."""
ContentT = TypeVar("ContentT", bound=Content)
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
    measures: dict[Word, float] = Field(default={})
    result_hash: Sha256


class CombinedResult(StrictModel):
    """What it reached in all tasks that its track ranks together."""

    success_rate: Rate
    mean_steps: float | None
    measures: dict[Word, float] = Field(default={})


class SaltedContent(Content):
    """What a receipt says; in the log is only its salted hash."""

    is_public = False

    salt: Annotated[str, Field(pattern=r"^[0-9a-f]{32}$")]
    """Random, so that nobody finds the content by trying which one has the hash in the log."""


class OfSubmission(SaltedContent):
    """What the receipts of a submission and of its results have in common."""

    submission: UUID
    submission_digest: Sha256
    competition: str
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
        """The board on which the result may be, as the log names it."""
        return board_name(self.competition, self.track, self.stage, self.kind.board)

    def is_of_team(self, name: str) -> bool:
        """Return whether the team had that name when the receipt was issued."""
        return self.team_sha256 == team_commitment(self.salt, name)


class Arrival(OfSubmission):
    """A submission that has arrived, before anybody knows its result."""

    stands_for = EntryKind.SUBMISSION

    final_of: UUID | None = None
    """The chosen submission that arrived before, where this one plays the final list of its stage; null elsewhere."""


class Result(OfSubmission):
    """The final result of one evaluation."""

    stands_for = EntryKind.RESULT

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
    """A place of the prize table, and the submission or the attempt that wins it."""

    track: Word
    place: str
    rank: PositiveInt
    team: str
    amount: NonNegativeInt
    currency: str
    submission: UUID | None
    """Null, as the hash, where operators entered the results."""
    result_hash: Sha256 | None
    total: float | None
    points: float | None = None
    evidence: str | None = None


class JudgedEntry(StrictModel):
    """What the judges think of a submission: the mean of their marks by criterion, and its total."""

    track: Word
    team: str
    submission: UUID
    criteria: dict[str, float]
    total: float | None


class End(Content):
    """The end of a competition, with names; signed again where its winners are decided again, or it is reopened."""

    stands_for = EntryKind.END

    competition: str
    """Name of the competition."""
    finalized_at: datetime | None
    """Null: the competition was reopened, and there are no winners."""
    reason: str | None
    """Why it was reopened."""
    winners: tuple[WinningEntry, ...]
    judged: tuple[JudgedEntry, ...]

    @property
    def board(self) -> str:
        """Which competition it ends, as the log names it."""
        return end_name(self.competition)


def team_commitment(salt: str, name: str) -> str:
    """Return the SHA-256 [hex] by which a receipt names a team: its name cannot be read from it, only compared."""
    return hashlib.sha256(canonical_json({"salt": salt, "team": name})).hexdigest()


def end_name(competition: str) -> str:
    """Return how the log names the end of a competition."""
    return f"end of {competition}"


def board_name(competition: str, track: str, stage: str, kind: SubmissionKind) -> str:
    """Return how the log names the boards of a stage: those of all tasks together and of each one."""
    return f"{competition}/{track}/{stage}/{kind}"


class SignedContent(StrictModel, Generic[ContentT]):
    """An entry of the log with the content that it stands for, and proofs that it is in the log."""

    format: Literal["vitac-receipt-2"] = "vitac-receipt-2"
    entry: LogEntry
    public_key: PublicKey
    proofs: tuple[Annotated[str, Field(max_length=2 * MAX_NOTE_CHARS)], ...] = ()
    """As https://c2sp.org/tlog-proof: by the newest checkpoint, and by those that witnesses signed."""

    @property
    def content(self) -> ContentT:
        """What was signed."""
        raise NotImplementedError

    def require_content(self) -> None:
        """Refuse a content that is not the one of the entry.

        Raises:
            ReceiptRejected: it says what differs.
        """
        number, expected = self.entry.number, self.content.entry(self.entry.number)
        if expected.content_sha256 != self.entry.content_sha256:
            raise ReceiptRejected(
                f"The {self.entry.content} of receipt {number} was changed: expected SHA-256 "
                f"{self.entry.content_sha256}, got {expected.content_sha256}."
            )
        for name in ("content", "board", "issued_at", "statement"):
            if getattr(expected, name) != getattr(self.entry, name):
                raise ReceiptRejected(
                    f"Receipt {number} has another {name} than its entry: expected {getattr(expected, name)}, got "
                    f"{getattr(self.entry, name)}."
                )

    def require_valid(self, public_key: str | None = None) -> None:
        """Refuse a receipt that is not whole, not of that key, or not in the log by all of its proofs.

        Args:
            public_key: of the service [hex]; None: whichever the receipt names.

        Raises:
            ReceiptRejected: it says what differs.
        """
        self.require_content()
        if public_key is not None and self.public_key != public_key:
            raise ReceiptRejected(
                f"Receipt {self.entry.number} is of another service: expected the key {public_key}, got "
                f"{self.public_key}."
            )
        if not self.proofs:
            raise ReceiptRejected(f"Receipt {self.entry.number} has no proof that it is in the log.")
        for proof in self.parsed_proofs():
            try:
                proof.require_valid(self.entry.leaf_hash, make_log_key(bytes.fromhex(self.public_key)))
            except (NoteRejected, ProofRejected) as error:
                raise ReceiptRejected(
                    f"Receipt {self.entry.number} is not in the log of {self.public_key} by its proof. {error}"
                ) from error
            if proof.index != self.entry.number - 1:
                raise ReceiptRejected(f"Receipt {self.entry.number} has the proof of another entry, {proof.index + 1}.")

    def parsed_proofs(self) -> list[InclusionProof]:
        """Return the proofs.

        Raises:
            ReceiptRejected: one of them does not have the form.
        """
        try:
            return list(map(InclusionProof.parse, self.proofs))
        except NoteRejected as error:
            raise ReceiptRejected(f"Receipt {self.entry.number}: {error}") from error

    def find_witnesses(self, keys: Iterable[VerifierKey]) -> dict[VerifierKey, datetime]:
        """Return which of some witnesses have signed a log that holds it, and when first."""
        by_witness: dict[VerifierKey, datetime] = {}
        for proof in self.parsed_proofs():
            for key, signed_at in proof.checkpoint.find_witnesses(keys):
                by_witness[key] = min(
                    datetime.fromtimestamp(signed_at, UTC), by_witness.get(key, datetime.max.replace(tzinfo=UTC))
                )
        return by_witness


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


MODELS: Mapping[EntryKind, type[AnyReceipt]] = MappingProxyType(
    {EntryKind.SUBMISSION: SubmissionReceipt, EntryKind.RESULT: Receipt, EntryKind.END: EndReceipt}
)
"""Models of the entries whose content is not in the log."""
