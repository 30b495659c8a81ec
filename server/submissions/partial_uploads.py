"""Uploads in pieces: begun, continued from where they ended, put together, removed.

The received bytes wait as parts in the file store, which all servers reach; rows say which parts count. Of two clients
that send the same piece the first one wins, the other learns where to continue: nothing is locked while bytes arrive,
so a connection that died unnoticed holds up nobody. Called by the API, `submissions.upload` and housekeeping.
"""

import hashlib
import secrets
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any
from uuid import UUID

from sqlalchemy import case, delete, func, select, update
from sqlalchemy.orm import Session, joinedload

from ..accounts import teams
from ..database.clock import read_clock
from ..database.models import PartialUpload, Team, UploadPart
from ..errors import ProblemCode, ServiceError, not_found
from ..principals import Principal
from ..services import Services
from ..settings import Settings
from .intake import FILE_NAME, AnnouncedUpload, ReceivedFile, empty
from .kinds import SERVED_KINDS

MAX_PARTS = 5000
"""Maximum number of parts of one upload: one of 512 MiB has 128, and one more for each lost connection."""


@dataclass(frozen=True, kw_only=True)
class StoredPart:
    """A part in the file store that does not count yet."""

    first_byte: int
    n_bytes: int
    key: str


def begin(session: Session, settings: Settings, owner: Team, announced: AnnouncedUpload) -> PartialUpload:
    """Make an upload that arrives at once; one of unknown length may be as large as its kind may."""
    upload = PartialUpload(team=owner, received_bytes=0, expires_at=_expiry(session, settings), **_values(announced))
    upload.total_bytes = announced.total_bytes or SERVED_KINDS[announced.kind].max_bytes(settings)
    session.add(upload)
    session.flush()
    return upload


def begin_resumable(session: Session, settings: Settings, owner: Team, announced: AnnouncedUpload) -> PartialUpload:
    """Make an upload, or return the team's unfinished one of the same content, which a client then continues.

    Raises:
        ServiceError: the team has too many unfinished uploads.
    """
    teams.lock(session, owner)
    unfinished = select(PartialUpload).where(
        PartialUpload.team_id == owner.id,
        PartialUpload.submission_id.is_(None),
        PartialUpload.expires_at > read_clock(session),
    )
    if announced.sha256 is not None:
        same = unfinished.filter_by(**_values(announced)).order_by(PartialUpload.received_bytes.desc()).limit(1)
        upload = session.scalar(same)
        if upload is not None:
            return upload
    if (session.scalar(select(func.count()).select_from(unfinished.subquery())) or 0) >= settings.unfinished_uploads:
        raise ServiceError(
            ProblemCode.TOO_MANY_UPLOADS,
            f"{owner.name} has {settings.unfinished_uploads} unfinished uploads, the most that are possible; finish or "
            f"delete one. Each is removed {settings.upload_kept_h} h after its last piece.",
        )
    return begin(session, settings, owner, announced)


def _values(announced: AnnouncedUpload) -> dict[str, Any]:
    return {name: value for name, value in vars(announced).items() if name != "team"}


def find(session: Session, by: Principal, upload_id: UUID) -> PartialUpload:
    """Return an upload.

    Raises:
        ServiceError: there is none that the principal may see; one that has expired is gone.
    """
    upload = session.get(PartialUpload, upload_id, options=[joinedload(PartialUpload.team)])
    if upload is None or not by.may_change(upload.team_id) or upload.expires_at <= read_clock(session):
        raise not_found("upload", upload_id)
    return upload


def store_part(services: Services, upload_id: UUID, first_byte: int, content: bytes) -> StoredPart:
    """Put bytes into the file store; they count once they are added.

    Raises:
        ServiceError: the store does not work.
    """
    name = f"{first_byte:015d}-{secrets.token_hex(8)}"
    key = services.blobs.put_part(str(upload_id), name, content)
    return StoredPart(first_byte=first_byte, n_bytes=len(content), key=key)


def add_parts(session: Session, settings: Settings, upload_id: UUID, parts: list[StoredPart]) -> datetime:
    """Make stored parts, which follow each other, the next ones of an upload; return when it expires now.

    Raises:
        ServiceError: the upload continues elsewhere, has too many parts, or is gone.
    """
    first, n_bytes = parts[0].first_byte, sum(part.n_bytes for part in parts)
    expires_at = _expiry(session, settings)
    advanced = session.execute(
        update(PartialUpload)
        .where(
            PartialUpload.id == upload_id,
            PartialUpload.received_bytes == first,
            PartialUpload.submission_id.is_(None),
        )
        .values(
            received_bytes=first + n_bytes,
            expires_at=expires_at,
            completed_at=case((PartialUpload.total_bytes == first + n_bytes, read_clock(session))),
        )
        .returning(PartialUpload.id)
    ).one_or_none()
    if advanced is None:
        raise conflict(session, upload_id, first)
    session.add_all(UploadPart(upload_id=upload_id, **vars(part)) for part in parts)
    session.flush()
    count = select(func.count()).select_from(UploadPart).where(UploadPart.upload_id == upload_id)
    if (session.scalar(count) or 0) > MAX_PARTS:
        raise ServiceError(
            ProblemCode.TOO_MANY_UPLOADS,
            f"The upload would have more than {MAX_PARTS} pieces; delete it and send larger ones.",
        )
    return expires_at


def end(session: Session, upload_id: UUID) -> None:
    """Let an upload whose length was not announced end where it is.

    Raises:
        ServiceError: no byte of it has arrived.
    """
    upload = lock(session, upload_id)
    if upload.received_bytes == 0:
        raise empty()
    upload.total_bytes, upload.completed_at = upload.received_bytes, read_clock(session)


def conflict(session: Session, upload_id: UUID, first_byte: int) -> ServiceError:
    """Return the refusal of a piece that does not begin where the upload continues."""
    offset = session.scalar(select(PartialUpload.received_bytes).where(PartialUpload.id == upload_id))
    if offset is None:
        return not_found("upload", upload_id)
    return ServiceError(
        ProblemCode.UPLOAD_CONFLICT,
        f"Expected a piece that begins at byte {offset}, got one for byte {first_byte}. Continue from there.",
        offset=offset,
    )


def put_together(services: Services, upload_id: UUID, folder: Path) -> ReceivedFile:
    """Write the parts of a complete upload into one file and hash it on the way.

    Raises:
        ServiceError: bytes are missing still, the upload was removed, or the file store does not work.
    """
    with services.database.transaction() as session:
        upload = session.get(PartialUpload, upload_id)
        if upload is None:
            raise not_found("upload", upload_id)
        keys = session.scalars(
            select(UploadPart.key).where(UploadPart.upload_id == upload_id).order_by(UploadPart.first_byte)
        ).all()
    if upload.received_bytes != upload.total_bytes:
        raise ServiceError(
            ProblemCode.UPLOAD_INCOMPLETE,
            f"Expected {upload.total_bytes} bytes, got {upload.received_bytes} so far. Send the rest first.",
            offset=upload.received_bytes,
        )
    path, digest = folder / FILE_NAME, hashlib.sha256()
    with path.open("xb") as file:
        for key in keys:
            content = services.blobs.part(key)
            digest.update(content)
            file.write(content)
    return ReceivedFile(path=path, sha256=digest.hexdigest(), n_bytes=upload.total_bytes)


def lock(session: Session, upload_id: UUID) -> PartialUpload:
    """Return an upload as it is now, and let nobody else finish or remove it until the end of the transaction.

    Raises:
        ServiceError: it was removed.
    """
    upload = session.get(PartialUpload, upload_id, with_for_update=True, populate_existing=True)
    if upload is None:
        raise not_found("upload", upload_id)
    return upload


def finish(session: Session, upload: PartialUpload, submission_id: UUID) -> None:
    """Note what an upload became; its parts count no longer."""
    upload.submission_id = submission_id
    session.execute(delete(UploadPart).where(UploadPart.upload_id == upload.id))


def remove(services: Services, upload_id: UUID) -> None:
    """Remove an upload with all its parts; removing it again changes nothing."""
    with services.database.transaction() as session:
        session.execute(delete(PartialUpload).where(PartialUpload.id == upload_id))
    services.blobs.delete_parts(str(upload_id))


def remove_expired(services: Services) -> None:
    """Remove the uploads that got no piece for too long, and parts of uploads that are not there."""
    with services.database.transaction() as session:
        has_expired = PartialUpload.expires_at <= read_clock(session)
        expired = session.scalars(delete(PartialUpload).where(has_expired).returning(PartialUpload.id)).all()
    for upload_id in expired:
        services.blobs.delete_parts(str(upload_id))
    with_parts = services.blobs.uploads_with_parts(timedelta(hours=services.settings.upload_kept_h))
    with services.database.transaction() as session:
        known = {str(upload_id) for upload_id in session.scalars(select(PartialUpload.id))}
    for upload in with_parts - known:
        services.blobs.delete_parts(upload)


def _expiry(session: Session, settings: Settings) -> datetime:
    return read_clock(session) + timedelta(hours=settings.upload_kept_h)
