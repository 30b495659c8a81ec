"""Storing and removing files so that neither undoes the other: both wait for the turn of the file's digest."""

from datetime import timedelta
from pathlib import Path

from sqlalchemy.orm import Session

from ..db.advisory_locks import AdvisoryLock, wait_for_turn
from .blobs import BlobStore


def store(session: Session, blobs: BlobStore, path: Path, digest: str) -> None:
    """Store a file under its digest; an old one gets the present time, so that housekeeping leaves it alone.

    Args:
        session: of the transaction that names the file, or of one for this alone; it holds the turn to its end.
        blobs: the file store.
        path: the file's content.
        digest: its SHA-256 [hex].
    """
    wait_for_turn(session, AdvisoryLock.STORED_FILE, digest)
    blobs.put(path, digest)


def remove_if_older(session: Session, blobs: BlobStore, digest: str, age: timedelta) -> None:
    """Remove a stored file that no row names, unless it was stored again meanwhile."""
    wait_for_turn(session, AdvisoryLock.STORED_FILE, digest)
    if blobs.is_older_than(digest, age):
        blobs.delete(digest)
