"""Storing and removing files so that neither undoes the other: both wait for the turn of the file's digest."""

from collections.abc import Collection, Iterable, Sequence
from datetime import timedelta
from pathlib import Path

from sqlalchemy import exists, select
from sqlalchemy.orm import Session

from ..database.engine import Database
from ..database.locks import AdvisoryLock, wait_for_turn
from ..database.models import Submission, SubmissionFile
from ..errors import ProblemCode, ServiceError
from .blobs import BlobStore, Piece


def store(session: Session, blobs: BlobStore, path: Path, digest: str, pieces: Sequence[Piece] = ()) -> None:
    """Store a file under its digest; an old one gets the present time, so that housekeeping leaves it alone.

    Args:
        session: of the transaction that names the file, or of one for this alone; it holds the turn to its end.
        blobs: the file store.
        path: the file's content.
        digest: its SHA-256 [hex].
        pieces: in which it is stored; empty: whole.
    """
    for each in sorted({digest, *(piece.sha256 for piece in pieces if piece.sha256)}):
        wait_for_turn(session, AdvisoryLock.STORED_FILE, each)
    if pieces:
        blobs.put_in_pieces(path, digest, pieces)
    else:
        blobs.put(path, digest)


def require_stored(session: Session, blobs: BlobStore, digests: Iterable[str]) -> None:
    """Refuse to name files that `remove_unnamed` has removed since they were stored, and keep it from doing so.

    The transaction has their turn to its end, so nothing else that others wait for may have been locked before.

    Raises:
        ServiceError: storage_unavailable; sent again they are stored again.
    """
    for digest in sorted(digests):
        wait_for_turn(session, AdvisoryLock.STORED_FILE, digest)
        if not blobs.holds(digest):
            raise ServiceError(
                ProblemCode.STORAGE_UNAVAILABLE, "The same file was refused and removed at this moment; send it again."
            )


def remove_unnamed(database: Database, blobs: BlobStore, digests: Iterable[str]) -> None:
    """Remove stored files that no submission names: of an upload that was refused, or that another archive made.

    With a file go those of its pieces that no other file has.
    """
    for digest in digests:
        with database.transaction() as session:
            wait_for_turn(session, AdvisoryLock.STORED_FILE, digest)
            names = (Submission.archive_sha256 == digest, SubmissionFile.sha256 == digest)
            is_named = any(session.scalar(select(exists().where(name))) for name in names)
            pieces: Collection[str] = () if is_named else blobs.list_pieces(digest)
            if not is_named and digest not in blobs.list_used_pieces():
                blobs.delete(digest)
        remove_unnamed(database, blobs, pieces)


def remove_if_older(session: Session, blobs: BlobStore, digest: str, age: timedelta) -> None:
    """Remove a stored file that no row names, unless it was stored again meanwhile."""
    wait_for_turn(session, AdvisoryLock.STORED_FILE, digest)
    if blobs.is_older_than(digest, age):
        blobs.delete(digest)
