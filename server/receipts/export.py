"""A board with its receipts, the chain and the records behind it in one zip, to be audited anywhere.

`export.json` says whose it is and holds the board, `chain.jsonl` all links, `receipts.jsonl` the receipts of
all results of the board's stage, also of those that are not on it, `logs/EVALUATION/TASK.jsonl` what was played for
entries of the board, as `vitac evaluate --log` writes it, and `sensors/EVALUATION.json` the sensor that it was played
with, where that is a team's own.
"""

import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path
from typing import BinaryIO, Final, Literal, TypeVar, cast, get_args
from uuid import UUID

from pydantic import BaseModel, Field, NonNegativeInt, ValidationError
from vitac.envs.errors import VitacError
from vitac.evaluator.logs.packing import MAX_UNPACKED_BYTES
from vitac.evaluator.sensors.made import MAX_BYTES as MAX_SENSOR_BYTES
from vitac.evaluator.strict_model import StrictModel, explain
from vitac.evaluator.submission_kinds import SubmissionKind

from ..views.leaderboards import LeaderboardView
from .receipt import Link, PublicKey, Receipt, Sha256

DESCRIPTION_NAME: Final = "export.json"
CHAIN_NAME: Final = "chain.jsonl"
RECEIPTS_NAME: Final = "receipts.jsonl"

ExportFormat = Literal["vitac-receipts-1", "vitac-receipts-2", "vitac-receipts-3"]
"""The first one holds only receipts of entries of the board, and tells nothing of teams; the second one holds no
sensors and does not say which logs are copies."""

ModelT = TypeVar("ModelT", bound=BaseModel)


class ExportRejected(VitacError):
    """A file is no export of a board's receipts, or damaged; make it again with `vitac admin receipt export`."""


class ExportedTeam(StrictModel):
    """A team with results in an export."""

    name: str
    evaluations: tuple[UUID, ...]
    former_names: tuple[str, ...] = ()
    """That it, or a team that was merged into it, had before, as the service says."""
    off_boards: str | None = None
    """Why it is on no board; null: it is."""
    is_removed: bool = False
    """Whether its data were deleted, with all names that it had."""


class ExportDescription(StrictModel):
    """What an export holds."""

    format: ExportFormat = "vitac-receipts-3"
    made_at: datetime
    public_key: PublicKey
    ranking: tuple[Literal["success_rate", "mean_steps", "submitted_at"], ...]
    """What entries are compared by, one after the other."""
    secret: Sha256 | None
    """Of the stage's sealed list, once published; null for a public list, and before."""
    board: LeaderboardView
    kind: SubmissionKind = SubmissionKind.MODEL
    """Of the submissions on the board."""
    receipts: NonNegativeInt | None = None
    """How many there are in the chain, as the service says."""
    last: Sha256 | None = None
    """Digest of the last one."""
    teams: tuple[ExportedTeam, ...] = ()
    """With results of the stage."""
    set_aside: tuple[UUID, ...] = ()
    """Evaluations whose results a rejudgement took off the boards, as the service says."""
    copies: tuple[UUID, ...] = ()
    """Evaluations of logs with the states of an earlier submission of another team, as the service says: unranked."""


class _Format(BaseModel):
    """What every format of exports says, whatever else it holds."""

    format: str = Field(max_length=40)


def log_name(evaluation: UUID, task: str) -> str:
    """Return the name of a log in an export."""
    return f"logs/{evaluation}/{task}.jsonl"


def sensor_name(evaluation: UUID) -> str:
    """Return the name of a team's sensor in an export."""
    return f"sensors/{evaluation}.json"


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
        if named not in get_args(ExportFormat):
            raise ExportRejected(
                f"{DESCRIPTION_NAME}: expected {', '.join(get_args(ExportFormat))}, got the format {named!r}. Audit it "
                "with the release that wrote it, or a newer one."
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

    def links(self) -> Iterator[Link]:
        """Yield the chain in the order of the file."""
        return self._lines(Link, CHAIN_NAME)

    def receipts(self) -> Iterator[Receipt]:
        """Yield the receipts."""
        return self._lines(Receipt, RECEIPTS_NAME)

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


def read_receipt(path: Path) -> Receipt:
    """Return the receipt in a file.

    Raises:
        ExportRejected: there is none in it.
    """
    try:
        with path.open("rb") as file:
            content = file.read(1 << 20)
    except OSError as error:
        raise ExportRejected(f"{path} cannot be read: {error.strerror}.") from error
    return _parsed(Receipt, content, str(path))


def _parsed(model: type[ModelT], content: bytes, origin: str) -> ModelT:
    try:
        return model.model_validate_json(content)
    except ValidationError as error:
        raise ExportRejected(f"{origin}: {explain(model, error)}") from error
