"""The log in the database: its key, one more entry, its tree, checkpoints and files."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import datetime
from uuid import UUID

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from sqlalchemy import func, select
from sqlalchemy.dialects.postgresql import insert
from sqlalchemy.orm import Session

from ..database.clock import read_clock
from ..database.locks import AdvisoryLock, wait_for_turn
from ..database.models import Cosignature, ReceiptKey, ReceiptRow, TreeNode
from ..errors import ProblemCode, ServiceError
from .entries import Content, LogEntry
from .merkle import TILE_WIDTH, Tree, hash_complete
from .notes import Checkpoint, Signature, VerifierKey, make_log_key, sign_checkpoint
from .tiles import MAX_ENTRY_BYTES


@dataclass(frozen=True, kw_only=True)
class LogState:
    """How long the log is, and what is signed of it."""

    public_key: str
    verifier_key: str
    receipts: int
    root: str
    checkpoint: str


def ensure_key(session: Session) -> ReceiptKey:
    """Return the key that signs the log, made at the first call of all."""
    key = session.get(ReceiptKey, 1)
    if key is None:
        made = Ed25519PrivateKey.generate()
        values = {
            "private_key": made.private_bytes_raw().hex(),
            "public_key": made.public_key().public_bytes_raw().hex(),
        }
        session.execute(insert(ReceiptKey).values(id=1, **values).on_conflict_do_nothing())
        key = session.get_one(ReceiptKey, 1)
    return key


def append(
    session: Session,
    make: Callable[[datetime], Content],
    *,
    submission_id: UUID | None = None,
    evaluation_id: UUID | None = None,
) -> None:
    """Add an entry to the log.

    From here to the end of the transaction nothing else is added: this is the last thing that it locks. The clock is
    the database's, which has also dated the submission.

    Args:
        session: of the transaction.
        make: returns what the entry stands for, from the moment at which it is issued, never before the last one.
        submission_id: of the submission that has arrived.
        evaluation_id: of the evaluation whose result it is.
    """
    session.flush()
    ensure_key(session)
    wait_for_turn(session, AdvisoryLock.RECEIPTS, "")
    last = session.scalar(select(ReceiptRow).order_by(ReceiptRow.number.desc()).limit(1))
    now = read_clock(session)
    content = make(max(now, parse_entry(last).issued_at) if last else now)
    entry = content.entry(last.number + 1 if last else 1)
    leaf = entry.leaf()
    if len(leaf) > MAX_ENTRY_BYTES:
        raise ServiceError(
            ProblemCode.INVALID_REQUEST,
            f"Expected an entry of the log of at most {MAX_ENTRY_BYTES} bytes, got {len(leaf)} for {entry.board}.",
        )
    session.add(
        ReceiptRow(
            number=entry.number,
            stands_for=entry.content,
            entry=leaf.decode(),
            leaf_hash=entry.leaf_hash,
            content=content.model_dump_json(),
            board=entry.board,
            submission_id=submission_id,
            evaluation_id=evaluation_id,
        )
    )
    session.flush()
    _add_nodes(session, entry.number)


def parse_entry(row: ReceiptRow) -> LogEntry:
    """Return the entry of a row."""
    return LogEntry.model_validate_json(row.entry)


def count_entries(session: Session) -> int:
    """Return the number of entries."""
    return session.scalar(select(func.max(ReceiptRow.number))) or 0


def read_log_key(session: Session) -> VerifierKey:
    """Return the public key of the log."""
    return make_log_key(bytes.fromhex(ensure_key(session).public_key))


def read_tree(session: Session) -> Tree:
    """Return the tree as it is now."""
    return Tree(count_entries(session), lambda level, number, width: read_hashes(session, level, number, width))


def read_hashes(session: Session, level: int, number: int, width: int) -> Sequence[bytes]:
    """Return the hashes of a tile, fewer where the log ends before."""
    first = TILE_WIDTH * number
    if level == 0:
        of_tile = ReceiptRow.number.between(first + 1, first + width)
        return session.scalars(select(ReceiptRow.leaf_hash).where(of_tile).order_by(ReceiptRow.number)).all()
    nodes = select(TreeNode.hash).where(TreeNode.level == level, TreeNode.number.between(first, first + width - 1))
    return session.scalars(nodes.order_by(TreeNode.number)).all()


def read_entries(session: Session, number: int, width: int) -> list[bytes]:
    """Return the entries of a tile."""
    first = TILE_WIDTH * number
    of_tile = ReceiptRow.number.between(first + 1, first + width)
    entries = session.scalars(select(ReceiptRow.entry).where(of_tile).order_by(ReceiptRow.number))
    return [entry.encode() for entry in entries]


def make_checkpoint(session: Session, tree: Tree, size: int | None = None) -> Checkpoint:
    """Return the checkpoint of a size with all that witnesses signed of it; `size` None: of the whole tree.

    Nothing random is in it, so that whoever asks for it again gets the same.
    """
    size = tree.size if size is None else size
    made = sign_checkpoint(bytes.fromhex(ensure_key(session).private_key), size=size, root=tree.root(size))
    lines = session.scalars(select(Cosignature).where(Cosignature.size == size).order_by(Cosignature.witness))
    return made.with_signatures(make_line(row) for row in lines)


def make_line(row: Cosignature) -> Signature:
    """Return a stored signature as a line of a note."""
    key = VerifierKey.parse(row.witness)
    return Signature(name=key.name, key_id=key.id, content=row.signature)


def read_log_state(session: Session) -> LogState:
    """Return key, length, root and newest checkpoint."""
    tree, key = read_tree(session), read_log_key(session)
    return LogState(
        public_key=key.public_key.hex(),
        verifier_key=str(key),
        receipts=tree.size,
        root=tree.root().hex(),
        checkpoint=str(make_checkpoint(session, tree)),
    )


def _add_nodes(session: Session, size: int) -> None:
    """Store the hashes over each tile that the last entry has completed."""
    level, number = 0, size
    while number % TILE_WIDTH == 0:
        number //= TILE_WIDTH
        hashes = read_hashes(session, level, number - 1, TILE_WIDTH)
        level += 1
        session.add(TreeNode(level=level, number=number - 1, hash=hash_complete(hashes)))
        session.flush()
