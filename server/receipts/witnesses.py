"""What witnesses sign of the log: taken in, counted, and how far each of them is behind."""

from collections.abc import Iterable
from datetime import UTC, datetime, timedelta
from typing import Any

from sqlalchemy import func, select
from sqlalchemy.dialects.postgresql import insert
from sqlalchemy.orm import Session

from ..competitions.competition import Competition
from ..competitions.stages import Stage
from ..database.clock import read_clock
from ..database.models import CompetitionRow, Cosignature, ReceiptRow
from ..errors import ProblemCode, ServiceError
from ..transparency.log import count_entries, make_checkpoint, parse_entry, read_log_key, read_tree
from ..transparency.notes import Checkpoint, NoteRejected, Signature, VerifierKey
from ..views.receipts import WitnessView

_CLOCK_DIFFERENCE = timedelta(minutes=5)


def list_witnesses(session: Session) -> list[VerifierKey]:
    """Return the witnesses that the competition files name, each once."""
    named = session.scalars(select(CompetitionRow.definition["witnesses"]))
    return [VerifierKey.parse(key) for key in dict.fromkeys(key for keys in named for key in keys or ())]


def add_cosignatures(session: Session, text: str) -> int:
    """Store what witnesses signed of a checkpoint of this log, and return how many have.

    Args:
        session: of the transaction.
        text: the checkpoint, signed by the log and by one witness or more.

    Raises:
        ServiceError: it is no checkpoint, of another log or of another history of this one, or no line is of a witness
            that a competition names.
    """
    try:
        checkpoint = Checkpoint.parse(text)
        checkpoint.require_signature(read_log_key(session))
    except NoteRejected as error:
        raise ServiceError(ProblemCode.INVALID_REQUEST, str(error)) from error
    tree = read_tree(session)
    if checkpoint.size > tree.size or tree.root(checkpoint.size) != checkpoint.root:
        raise ServiceError(
            ProblemCode.LOG_REWRITTEN,
            f"This service has signed a log of {checkpoint.size} entries that is not the beginning of the one that it "
            f"has now, of {tree.size}. Keep both checkpoints: they prove it.",
        )
    rows: dict[str, dict[str, Any]] = {
        str(key): {"witness": str(key), "size": checkpoint.size, "signature": line.content, "signed_at": signed_at}
        for key in list_witnesses(session)
        for line in checkpoint.signatures
        if (signed_at := _read_time(checkpoint, key, line)) is not None
    }
    if not rows:
        raise ServiceError(
            ProblemCode.UNKNOWN_WITNESS,
            f"No competition of this service names the witness {_name_signers(checkpoint)}. Send the organizers the "
            "key that `vitac witness key` prints: they put it into the competition file.",
        )
    latest = read_clock(session) + _CLOCK_DIFFERENCE
    of_now = [row for row in rows.values() if row["signed_at"] <= latest]
    if not of_now:
        early = min(row["signed_at"] for row in rows.values())
        raise ServiceError(
            ProblemCode.INVALID_REQUEST,
            f"Expected a signature of now, got one of {early:%Y-%m-%d %H:%M}Z: set the clock.",
        )
    session.execute(insert(Cosignature).values(of_now).on_conflict_do_nothing())
    return len(of_now)


def _read_time(checkpoint: Checkpoint, key: VerifierKey, line: Signature) -> datetime | None:
    seconds = checkpoint.read_cosignature(key, line)
    return None if seconds is None else datetime.fromtimestamp(seconds, UTC)


def _name_signers(checkpoint: Checkpoint) -> str:
    """Return whose lines a checkpoint has besides that of its log."""
    return " or ".join(line.name for line in checkpoint.signatures if line.name != checkpoint.origin) or "of no line"


def list_witness_views(session: Session) -> list[WitnessView]:
    """Return the witnesses, and how far each has come."""
    keys = list(map(str, list_witnesses(session)))
    if not keys:
        return []
    size, now = count_entries(session), read_clock(session)
    sizes = _signed_sizes(session)
    return [_witness_view(session, key, sizes.get(key), size, now) for key in keys]


def list_witnessed_checkpoints(session: Session) -> list[Checkpoint]:
    """Return the newest checkpoint that each witness has signed, the longest first."""
    tree = read_tree(session)
    sizes = {size for size, _ in _signed_sizes(session).values()}
    return [make_checkpoint(session, tree, size) for size in sorted(sizes, reverse=True)]


def require_witnessed(session: Session, competition: Competition) -> None:
    """Refuse where fewer witnesses than a stage demands have signed a log with all that it has of the stage.

    Raises:
        ServiceError: not_witnessed.
    """
    for stage in competition.stages_held_here:
        needed, last = stage.rules.witnesses, _last_entry(session, stage)
        signed = [size for size in _read_sizes(session, competition.definition.witnesses) if size >= last]
        if len(signed) < needed:
            raise ServiceError(
                ProblemCode.NOT_WITNESSED,
                f"Expected {needed} witnesses that have signed entry {last} of the log, the last one of {stage}, got "
                f"{len(signed)}. `vitac admin receipt witnesses` shows who is behind.",
            )


def _read_sizes(session: Session, keys: Iterable[str]) -> list[int]:
    sizes = _signed_sizes(session)
    return [sizes[key][0] for key in keys if key in sizes]


def _signed_sizes(session: Session) -> dict[str, tuple[int, datetime]]:
    """Return the longest log that each witness has signed, and when it signed last."""
    of_witness = func.max(Cosignature.size), func.max(Cosignature.signed_at)
    rows = session.execute(select(Cosignature.witness, *of_witness).group_by(Cosignature.witness))
    return {witness: (size, signed_at) for witness, size, signed_at in rows}


def _last_entry(session: Session, stage: Stage) -> int:
    of_stage = ReceiptRow.board.startswith(f"{stage.competition}/{stage.track}/{stage.name}/", autoescape=True)
    return session.scalar(select(func.max(ReceiptRow.number)).where(of_stage)) or 0


def _witness_view(
    session: Session, key: str, signed: tuple[int, datetime] | None, size: int, now: datetime
) -> WitnessView:
    signed_size, signed_at = signed or (0, None)
    oldest = session.get(ReceiptRow, signed_size + 1) if signed_size < size else None
    return WitnessView(
        witness=key,
        size=signed_size,
        behind=size - signed_size,
        behind_s=(now - parse_entry(oldest).issued_at).total_seconds() if oldest else 0.0,
        signed_at=signed_at,
    )
