"""The way of every upload: begun, received in pieces or as one, put together, checked, made a submission.

Called by the API's routes of uploads in pieces and at once, and by the upload page.
"""

import asyncio
from collections.abc import AsyncIterator
from contextlib import suppress
from dataclasses import replace
from datetime import datetime
from uuid import UUID

from sqlalchemy.orm import Session

from ..competitions.competition import Competition
from ..database.models import PartialUpload
from ..errors import ProblemCode, ServiceError
from ..principals import Principal
from ..services import Services
from ..storage.scratch import require_room
from ..storage.stored_files import require_stored
from ..tracks import load_known_track
from ..views.submissions import SubmissionView
from . import creation, intake, listing, partial_uploads
from .intake import AnnouncedUpload
from .kinds import SERVED_KINDS, accept, check_kind, remove_unnamed, removed_if_refused
from .pieces import PieceReceiver


def begin(services: Services, by: Principal, announced: AnnouncedUpload, *, is_resumable: bool) -> PartialUpload:
    """Begin an upload, or continue the team's unfinished one of the same content.

    Args:
        services: of this process.
        by: who sends it.
        announced: what the client says of it.
        is_resumable: whether it comes in pieces that somebody continues.

    Raises:
        ServiceError: it cannot be accepted whatever the body holds: its size, kind, track or file's name is wrong, the
            disk is almost full, or the team has used one of its quotas.
    """
    settings = services.settings
    intake.check_announced(announced, SERVED_KINDS[announced.kind].max_bytes(settings))
    require_room(settings, announced.total_bytes or 0)
    if announced.track is not None:
        check_kind(announced.kind, load_known_track(announced.track))
    with services.database.transaction() as session:
        owner = creation.expect_upload(session, settings.quotas, by, announced)
        intake.check_file_name(announced.file_name, team=owner.name)
        make = partial_uploads.begin_resumable if is_resumable else partial_uploads.begin
        return make(session, settings, owner, announced)


async def receive(
    services: Services, by: Principal, announced: AnnouncedUpload, body: AsyncIterator[bytes]
) -> tuple[SubmissionView, bool]:
    """Receive a body that arrives at once, as the one piece of an upload that is removed with the answer.

    Args:
        services: of this process.
        by: who sends it.
        announced: what the client says of it.
        body: its bytes.

    Returns:
        the submission, and whether its evaluation was started.

    Raises:
        ServiceError: a rule is broken; all that needs no body is checked before any of it is read.
    """
    partial = await asyncio.to_thread(begin, services, by, announced, is_resumable=False)
    piece = PieceReceiver(
        services=services,
        upload_id=partial.id,
        offset=0,
        end=partial.total_bytes,
        checksum=None,
        expires_at=partial.expires_at,
    )
    try:
        await piece.receive(body)
        return await asyncio.to_thread(_end, services, by, partial, announced)
    finally:
        with suppress(ServiceError):  # housekeeping removes what could not be removed now
            await asyncio.to_thread(partial_uploads.remove, services, partial.id)


def _end(
    services: Services, by: Principal, partial: PartialUpload, announced: AnnouncedUpload
) -> tuple[SubmissionView, bool]:
    if announced.total_bytes is None:
        with services.database.transaction() as session:
            partial_uploads.end(session, partial.id)
    submission_id, is_new = _make(services, by, partial)
    with services.database.transaction() as session:
        return listing.get(session, services.settings, by, submission_id), is_new


_TRANSIENT = frozenset(
    {
        ProblemCode.QUOTA_EXCEEDED,
        ProblemCode.STORAGE_FULL,
        ProblemCode.STORAGE_UNAVAILABLE,
        ProblemCode.TOO_MANY_REQUESTS,
        ProblemCode.UPLOAD_INCOMPLETE,
    }
)
"""Refusals after which the upload stays, so that the client can ask again; after all others it is of no use."""


def complete(services: Services, by: Principal, upload_id: UUID) -> tuple[UUID, bool]:
    """Check an upload whose bytes are all there and make its submission; return that, and whether it was started.

    Asked for again, it returns the submission that it made, so that a client whose connection was cut can repeat it.

    Raises:
        ServiceError: bytes are missing, or the body breaks a rule.
    """
    with services.database.transaction() as session:
        upload = partial_uploads.find(session, by, upload_id)
    if upload.submission_id is not None:
        return upload.submission_id, False
    try:
        submission = _make(services, by, upload)
    except ServiceError as error:
        made = _made_meanwhile(services, upload_id)
        if made is not None:
            return made, False
        if error.code not in _TRANSIENT:
            partial_uploads.remove(services, upload_id)
        raise
    with suppress(ServiceError):  # The submission is made; housekeeping removes the parts with the upload.
        services.blobs.delete_parts(str(upload_id))
    return submission


def _make(services: Services, by: Principal, upload: PartialUpload) -> tuple[UUID, bool]:
    with intake.upload_folder(services.settings) as folder:
        received = partial_uploads.put_together(services, upload.id, folder)
        intake.check_digest(received, upload.sha256)
        checked = accept(services, received, kind=upload.kind, track=upload.track, owner=upload.team.name)
    checked = replace(checked, file_name=upload.file_name)
    with removed_if_refused(services, checked), services.database.transaction() as session:
        require_stored(session, services.blobs, checked.digests)
        locked = partial_uploads.lock(session, upload.id)
        if locked.submission_id is not None:
            return locked.submission_id, False
        submission, is_new = creation.create(
            session,
            by,
            checked,
            team=str(upload.team_id),
            competition=upload.competition,
            again=upload.again,
            quotas=services.settings.quotas,
            at=_find_arrival_in_time(session, locked, checked.track),
        )
        partial_uploads.finish(session, locked, submission.id)
    if not is_new or submission.archive_sha256 != checked.archive_sha256:
        remove_unnamed(services, checked)
    return submission.id, is_new


def _find_arrival_in_time(session: Session, upload: PartialUpload, track: str) -> datetime | None:
    """Return when an upload was complete if its track took submissions then: its bytes count, not the last request."""
    at = upload.completed_at
    named = upload.competition
    competitions = Competition.read_by_track(session, track) if named is None else [Competition.find(session, named)]
    stages = [stage for competition in competitions for stage in competition.list_stages(track)]
    was_open = at is not None and any(stage.is_open(at) for stage in stages)
    return at if was_open else None


def _made_meanwhile(services: Services, upload_id: UUID) -> UUID | None:
    """Return the submission that another request made of the upload meanwhile, whose parts are gone then."""
    with services.database.transaction() as session:
        upload = session.get(PartialUpload, upload_id)
        return None if upload is None else upload.submission_id
