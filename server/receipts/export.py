"""A board with its receipts, the log and the records behind it in one zip, to be audited anywhere.

`export.json` says whose it is and holds the board, `log.jsonl` all entries of the log, `submissions.jsonl` and
`receipts.jsonl` the receipts of all submissions to the board's stage and of their results, also of those that are not
on it, `ends.jsonl` those of the competition's end, `logs/EVALUATION/TASK.jsonl` what was played for entries of the
board, as `vitac evaluate --log` writes it, `sensors/EVALUATION.json` the sensor that it was played with, where that is
a team's own, and `tracks/TRACK.yaml` the file of a track that does not come with the evaluator.
"""

import hashlib
import json
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path
from typing import BinaryIO, Final, Literal, TypeVar, cast
from uuid import UUID

from pydantic import BaseModel, Field, ValidationError
from vitac.errors import VitacError
from vitac.evaluator.episodes.records import canonical_json
from vitac.evaluator.logs.log import MAX_UNPACKED_BYTES
from vitac.evaluator.sensors.made import MAX_BYTES as MAX_SENSOR_BYTES
from vitac.evaluator.strict_model import StrictModel, explain
from vitac.evaluator.submission_kinds import SubmissionKind

from ..transparency.entries import FinalBoard, LogEntry, Sha256
from ..views.leaderboards import LeaderboardView
from .receipt import (
    MODELS,
    AnyReceipt,
    EndReceipt,
    JudgedEntry,
    PublicKey,
    Receipt,
    SubmissionReceipt,
    WinningEntry,
)

DESCRIPTION_NAME: Final = "export.json"
LOG_NAME: Final = "log.jsonl"
SUBMISSIONS_NAME: Final = "submissions.jsonl"
RECEIPTS_NAME: Final = "receipts.jsonl"
ENDS_NAME: Final = "ends.jsonl"

FORMAT: Final = "vitac-receipts-2"

ModelT = TypeVar("ModelT", bound=BaseModel)


class ExportRejected(VitacError):
    """A file is no export of a board's receipts, or damaged; make it again with `vitac admin receipt export`."""


class ExportedTeam(StrictModel):
    """A team with results in an export."""

    name: str
    evaluations: tuple[UUID, ...]
    former_names: tuple[str, ...] = ()
    """Earlier names of the team, or of one that was merged into it, as the service says."""
    off_boards: str | None = None
    """Why it is on no board; null: it is."""
    disqualified: tuple[UUID, ...] = ()
    """Its evaluations that are on no board because their submission was disqualified."""
    is_removed: bool = False
    """Whether its data were deleted, with all names that it had."""


class ExportDescription(StrictModel):
    """What an export holds."""

    format: Literal["vitac-receipts-2"] = FORMAT
    made_at: datetime
    public_key: PublicKey
    secret: Sha256 | None
    """Secret of the stage's sealed list, once published; null for a public list, and before."""
    commitment: Sha256 | None
    """Commitment of the stage's sealed list; null for a public list."""
    competition: str
    """Name of the board's competition; empty outside of one."""
    board: LeaderboardView
    kind: SubmissionKind
    """Kind of the submissions on the board."""
    checkpoint: str
    """Checkpoint of the whole log, as the service and its witnesses signed it."""
    witnesses: tuple[str, ...] = ()
    """Keys of those who sign the log, as the competition's file names them."""
    witnessed: tuple[str, ...] = ()
    """The newest checkpoint that each of them has signed."""
    teams: tuple[ExportedTeam, ...]
    """Teams with results in the stage."""
    set_aside: tuple[UUID, ...]
    """Evaluations whose results a rejudgement took off the boards, as the service says."""
    copies: tuple[UUID, ...]
    """Evaluations that have the states, or nearly the actions, of another team's earlier ones, as the service says."""
    winners: tuple[WinningEntry, ...]
    """Winners of the competition, once it is final."""
    judged: tuple[JudgedEntry, ...]
    """What the judges think of its judged tracks' entries, once it is final."""


class _ReceiptFile(BaseModel):
    """What every receipt says, whatever it is of."""

    entry: LogEntry


class _Format(BaseModel):
    """What every format of exports says, whatever else it holds."""

    format: str = Field(max_length=40)


def log_name(evaluation: UUID, task: str) -> str:
    """Return the name of a log in an export."""
    return f"logs/{evaluation}/{task}.jsonl"


def sensor_name(evaluation: UUID) -> str:
    """Return the name of a team's sensor in an export."""
    return f"sensors/{evaluation}.json"


def track_name(track: str) -> str:
    """Return the name of a track's file in an export."""
    return f"tracks/{track}.yaml"


class ExportReader:
    """Reads the members of an export.

    Raises:
        ExportRejected: here and in all methods, what is read is no part of an export.
    """

    def __init__(self, archive: zipfile.ZipFile) -> None:
        self._archive = archive
        self._names = set(archive.namelist())
        with self._open(DESCRIPTION_NAME) as stream:
            content = stream.read()
        named = _parsed(_Format, content, DESCRIPTION_NAME).format
        if named != FORMAT:
            raise ExportRejected(
                f"{DESCRIPTION_NAME}: expected {FORMAT}, got the format {named!r}. Audit it with the release that "
                "wrote it."
            )
        self.description = _parsed(ExportDescription, content, DESCRIPTION_NAME)

    @classmethod
    @contextmanager
    def opened(cls, path: Path) -> Iterator["ExportReader"]:
        """Open an export."""
        try:
            with zipfile.ZipFile(path) as archive:
                yield cls(archive)
        except (OSError, zipfile.BadZipFile, NotImplementedError, RuntimeError) as error:
            raise ExportRejected(f"{path} cannot be read as an export of receipts: {error}.") from error

    def entries(self) -> Iterator[LogEntry]:
        """Yield the entries of the log in the order of the file."""
        return self._lines(LogEntry, LOG_NAME)

    def submissions(self) -> Iterator[SubmissionReceipt]:
        """Yield the receipts of submissions."""
        return self._lines(SubmissionReceipt, SUBMISSIONS_NAME)

    def receipts(self) -> Iterator[Receipt]:
        """Yield the receipts of results."""
        return self._lines(Receipt, RECEIPTS_NAME)

    def ends(self) -> Iterator[EndReceipt]:
        """Yield the receipts of the competition's end."""
        return self._lines(EndReceipt, ENDS_NAME)

    def track_file(self, track: str) -> bytes | None:
        """Return the file of a track that does not come with the evaluator; None where it does."""
        if track_name(track) not in self._names:
            return None
        with self._open(track_name(track)) as stream:
            return stream.read()

    def has_log(self, evaluation: UUID, task: str) -> bool:
        """Return whether the records of a task are here."""
        return log_name(evaluation, task) in self._names

    @contextmanager
    def log(self, evaluation: UUID, task: str) -> Iterator[BinaryIO]:
        """Open the log of a task."""
        with self._open(log_name(evaluation, task)) as stream:
            yield stream

    def has_sensor(self, evaluation: UUID) -> bool:
        """Return whether the sensor of an evaluation is here."""
        return sensor_name(evaluation) in self._names

    def sensor(self, evaluation: UUID) -> bytes:
        """Return the file of a sensor, of a larger one than any may be only its beginning."""
        with self._open(sensor_name(evaluation)) as stream:
            return stream.read(MAX_SENSOR_BYTES + 1)

    def _lines(self, model: type[ModelT], name: str) -> Iterator[ModelT]:
        with self._open(name) as stream:
            for number, line in enumerate(stream, start=1):
                yield _parsed(model, line, f"{name}, line {number}")

    @contextmanager
    def _open(self, name: str) -> Iterator[BinaryIO]:
        if name not in self._names:
            raise ExportRejected(f"The export has no {name}; it is incomplete.")
        n_bytes = self._archive.getinfo(name).file_size  # zipfile gives no more than that, whatever is packed
        if n_bytes > MAX_UNPACKED_BYTES:
            raise ExportRejected(f"{name}: expected at most {MAX_UNPACKED_BYTES} bytes, got {n_bytes}.")
        with self._archive.open(name) as stream:
            yield cast(BinaryIO, stream)


def read_receipts(path: Path) -> list[AnyReceipt]:
    """Return the receipt in a file, of whatever it is, or all of a list of them, as the API gives one.

    Raises:
        ExportRejected: there is none in it.
    """
    try:
        with path.open("rb") as file:
            content = file.read(1 << 20)
    except OSError as error:
        raise ExportRejected(f"{path} cannot be read: {error.strerror}.") from error
    if not content.lstrip().startswith(b"["):
        return [_read_receipt(content, str(path))]
    try:
        listed = json.loads(content)
    except ValueError as error:
        raise ExportRejected(f"{path} is no JSON: {error}.") from error
    if not listed:
        raise ExportRejected(f"{path} is an empty list: there is no receipt yet. Fetch it when the result is there.")
    return [_read_receipt(json.dumps(one).encode(), f"{path}, number {n}") for n, one in enumerate(listed, start=1)]


def _read_receipt(content: bytes, origin: str) -> AnyReceipt:
    named = _parsed(_ReceiptFile, content, origin).entry.content
    if named not in MODELS:
        raise ExportRejected(f"{origin}: expected a receipt of one of {', '.join(MODELS)}, got {named}.")
    return _parsed(MODELS[named], content, origin)


def _parsed(model: type[ModelT], content: bytes, origin: str) -> ModelT:
    try:
        return model.model_validate_json(content)
    except ValidationError as error:
        raise ExportRejected(f"{origin}: {explain(model, error)}") from error


_FIELDS = ("rank", "submission_id", "evaluation_id", "success_rate", "mean_steps", "result_hash")


def hash_board(board: LeaderboardView) -> str:
    """Return the SHA-256 [hex] over what a board says of its entries, whatever names of teams it shows."""
    entries = [entry.model_dump(mode="json", include=set(_FIELDS)) for entry in board.entries]
    return hashlib.sha256(canonical_json({"entries": entries})).hexdigest()


def make_final_board(competition: str, board: LeaderboardView, at: datetime) -> FinalBoard:
    """Return what the log says of a board."""
    return FinalBoard(
        issued_at=at,
        competition=competition,
        track=board.track,
        stage=board.stage or "",
        entries=len(board.entries),
        board_sha256=hash_board(board),
    )
