"""What an entry of the log says, in public, and the contents that entries stand for.

Of submissions and results an entry shows a salted hash only, so that the log is public while results of sealed lists
and frozen boards are not. Everything else is a statement that everybody may read in the entry itself.
"""

import hashlib
from datetime import datetime
from enum import StrEnum
from typing import Annotated, Any, ClassVar, Literal
from uuid import UUID

from pydantic import Field, NonNegativeInt, PositiveInt
from vitac.evaluator.episodes.records import canonical_json
from vitac.evaluator.strict_model import StrictModel, Word

from .merkle import hash_leaf

Sha256 = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]


class EntryKind(StrEnum):
    """What an entry of the log stands for."""

    SUBMISSION = "submission"
    """A submission that has arrived."""
    RESULT = "result"
    """The final result of an evaluation."""
    END = "end"
    """The end of a competition: its winners."""
    COMPETITION = "competition"
    """A competition file that was applied."""
    SEALED_LIST = "sealed_list"
    """The commitment to a sealed list, and what happened to the list."""
    ADVANCEMENT = "advancement"
    """Who may take part in a stage."""
    REJUDGEMENT = "rejudgement"
    """Results that were replaced by those of another evaluation."""
    FINAL_LIST = "final_list"
    """Which submissions play the final list of a stage."""
    AUDIT_LOG = "audit_log"
    """Lines of the audit log, as a digest: what organizers did."""
    BOARD = "board"
    """A board as it was at the end of a competition."""


class LogEntry(StrictModel):
    """An entry of the log; its bytes are a leaf of the tree."""

    number: PositiveInt
    """From 1; its index in the tree is one less."""
    content: EntryKind
    content_sha256: Sha256
    board: Annotated[str, Field(max_length=300)]
    """Competition, track, stage and kind (`board_name`), so that nothing of a board can be left out of an export."""
    issued_at: datetime
    """Never before that of the entry before."""
    statement: dict[str, Any] | None = None
    """The content, where everybody may read it."""

    def leaf(self) -> bytes:
        """Return the bytes that the tree has the hash of."""
        return canonical_json(self.model_dump(mode="json", exclude_none=self.statement is None))

    @property
    def leaf_hash(self) -> bytes:
        """The leaf of the tree."""
        return hash_leaf(self.leaf())


class Content(StrictModel):
    """What an entry stands for."""

    stands_for: ClassVar[EntryKind]
    is_public: ClassVar[bool] = True

    issued_at: datetime

    def digest(self) -> str:
        """Return the SHA-256 [hex] by which the log names this content."""
        return hashlib.sha256(canonical_json(self.model_dump(mode="json"))).hexdigest()

    @property
    def board(self) -> str:
        """Where it belongs, as the log names it."""
        raise NotImplementedError

    def entry(self, number: int) -> LogEntry:
        """Return the entry of the log that stands for this content."""
        return LogEntry(
            number=number,
            content=self.stands_for,
            content_sha256=self.digest(),
            board=self.board,
            issued_at=self.issued_at,
            statement=self.model_dump(mode="json") if self.is_public else None,
        )


class AuditLogGrown(Content):
    """Further lines of the audit log, of which nobody but organizers reads more than this."""

    stands_for = EntryKind.AUDIT_LOG

    first: PositiveInt
    last: PositiveInt
    lines: PositiveInt
    lines_sha256: Sha256
    """Over the lines, each as canonical JSON, in the order of their numbers."""

    @property
    def board(self) -> str:
        """No board: it is of the whole service."""
        return "audit log"


class OfCompetition(Content):
    """What is said of a competition."""

    competition: str

    @property
    def board(self) -> str:
        """The boards of all its tracks and stages."""
        return f"{self.competition}/"


class OfStage(OfCompetition):
    """What is said of a stage; its name is empty outside of a competition."""

    track: Word
    stage: str

    @property
    def board(self) -> str:
        """The boards of the stage, of models and of logs."""
        return f"{self.competition}/{self.track}/{self.stage}/"


class CompetitionApplied(OfCompetition):
    """A competition file that was applied."""

    stands_for = EntryKind.COMPETITION

    definition: dict[str, Any]
    """With all defaults, but without the contact, who may be a person: an entry is never removed."""


class SealedListChanged(OfStage):
    """What happened to a sealed list; its secret only once it is published."""

    stands_for = EntryKind.SEALED_LIST

    change: Literal["sealed", "withdrawn", "published"]
    commitment: Sha256
    secret: Sha256 | None = None


class TeamsAdvanced(OfStage):
    """Who may take part in a stage, by what they have reached in the one before."""

    stands_for = EntryKind.ADVANCEMENT

    teams: NonNegativeInt
    submissions: tuple[UUID, ...]
    """Submissions on the board before, by which teams advance; teams that the organizers added have none."""


class RejudgementApplied(OfStage):
    """Results that were replaced."""

    stands_for = EntryKind.REJUDGEMENT

    rejudgement: UUID
    replaced: NonNegativeInt
    """Submissions with a result of the rejudgement."""
    withdrawn: NonNegativeInt
    """Submissions that it left without a result."""


class FinalListPlayed(OfStage):
    """Which submissions play a final list, all together and once, after the stage has closed."""

    stands_for = EntryKind.FINAL_LIST

    submissions: tuple[UUID, ...]
    """Those that were chosen; each plays it as another submission, whose receipt names it."""


class FinalBoard(OfStage):
    """A board as it was at the end of a competition."""

    stands_for = EntryKind.BOARD

    entries: NonNegativeInt
    board_sha256: Sha256
    """Hash of its entries as canonical JSON: rank, submission, evaluation, success rate, mean steps, result hash."""
