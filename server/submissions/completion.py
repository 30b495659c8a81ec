"""Makes the submission out of an upload in pieces; called by the API."""

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
from ..storage.stored_files import require_stored
from ..uploads import intake, partial
from ..uploads.acceptance import accept, remove_unnamed, removed_if_refused
from . import creation

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
        upload = partial.find(session, by, upload_id)
    if upload.submission_id is not None:
        return upload.submission_id, False
    try:
        return _make(services, by, upload)
    except ServiceError as error:
        made = _made_meanwhile(services, upload_id)
        if made is not None:
            return made, False
        if error.code not in _TRANSIENT:
            partial.remove(services, upload_id)
        raise


def _make(services: Services, by: Principal, upload: PartialUpload) -> tuple[UUID, bool]:
    with intake.upload_folder(services.settings) as folder:
        received = partial.put_together(services, upload.id, folder)
        intake.check_digest(received, upload.sha256)
        checked = accept(services, received, kind=upload.kind, track=upload.track, owner=upload.team.name)
    checked = replace(checked, file_name=upload.file_name)
    with removed_if_refused(services, checked), services.database.transaction() as session:
        require_stored(session, services.blobs, checked.digests)
        locked = partial.lock(session, upload.id)
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
        partial.finish(session, locked, submission.id)
    if not is_new or submission.archive_sha256 != checked.archive_sha256:
        remove_unnamed(services, checked)
    with suppress(ServiceError):  # The submission is made; housekeeping removes the parts with the upload.
        services.blobs.delete_parts(str(upload.id))
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
