"""Makes a submission out of a body that arrives at once; called by the API's upload route and the upload page."""

import asyncio
from collections.abc import AsyncIterator
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import datetime
from uuid import UUID

from sqlalchemy.orm import Session
from starlette.requests import ClientDisconnect
from vitac.evaluator.submission_kinds import SubmissionKind

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
from .intake import CheckedUpload, check_file_name
from .kinds import SERVED_KINDS, accept, check_kind, remove_unnamed, removed_if_refused


@dataclass(frozen=True, kw_only=True)
class AnnouncedUpload:
    """What a client says of a body before it sends it.

    Attributes:
        kind: what the body is.
        track: that the body must name; None: whatever it names.
        competition: name of the competition; None: the one that takes submissions to the track.
        team: for an organizer: whose submission it becomes.
        again: run all episodes again, including stored ones.
        n_bytes: length of the body; None if the client did not send it.
        sha256: digest of the body, hex; None if the client did not send it.
        file_name: of the body; None if the client did not send it.
    """

    kind: SubmissionKind
    track: str | None = None
    competition: str | None = None
    team: str | None = None
    again: bool = False
    n_bytes: int | None = None
    sha256: str | None = None
    file_name: str | None = None


def check(services: Services, upload: AnnouncedUpload) -> None:
    """Refuse what cannot be accepted whatever the body holds, before any of it is read.

    Raises:
        ServiceError: it is too large, the disk is almost full, or the track does not exist or does not take its kind.
    """
    intake.check_announced_size(upload.n_bytes, SERVED_KINDS[upload.kind].max_bytes(services.settings))
    require_room(services.settings, upload.n_bytes or 0)
    if upload.track is not None:
        check_kind(upload.kind, load_known_track(upload.track))


async def receive(
    services: Services, by: Principal, upload: AnnouncedUpload, body: AsyncIterator[bytes]
) -> tuple[SubmissionView, bool]:
    """Receive a body, check it and start its evaluation; return the submission, and whether anything was started.

    Args:
        services: of this process.
        by: who sends it.
        upload: what was announced; `check` has accepted it.
        body: its bytes.

    Raises:
        ServiceError: a rule is broken, or, before the body is read, that the team has used one of its quotas.
    """
    owner = await asyncio.to_thread(_owner, services, by, upload)
    with intake.upload_folder(services.settings) as folder:
        try:
            received = await intake.receive(
                body,
                folder,
                limit_bytes=SERVED_KINDS[upload.kind].max_bytes(services.settings),
                idle_timeout_s=services.settings.upload_idle_timeout_s,
                announced_bytes=upload.n_bytes,
            )
        except ClientDisconnect as error:
            raise intake.truncated("the connection was closed") from error
        intake.check_digest(received, upload.sha256)
        checked = await asyncio.to_thread(accept, services, received, kind=upload.kind, track=upload.track, owner=owner)
    return await asyncio.to_thread(_create, services, by, upload, replace(checked, file_name=upload.file_name))


def _owner(services: Services, by: Principal, upload: AnnouncedUpload) -> str:
    with services.database.transaction() as session:
        owner = creation.expect_upload(
            session,
            services.settings.quotas,
            by,
            team=upload.team,
            sha256=upload.sha256,
            track=upload.track,
            competition=upload.competition,
        )
        check_file_name(upload.file_name, team=owner.name)
        return owner.name


def _create(
    services: Services, by: Principal, upload: AnnouncedUpload, checked: CheckedUpload
) -> tuple[SubmissionView, bool]:
    with removed_if_refused(services, checked), services.database.transaction() as session:
        require_stored(session, services.blobs, checked.digests)
        submission, is_new = creation.create(
            session,
            by,
            checked,
            team=upload.team,
            competition=upload.competition,
            again=upload.again,
            quotas=services.settings.quotas,
        )
    if not is_new or submission.archive_sha256 != checked.archive_sha256:
        remove_unnamed(services, checked)
    with services.database.transaction() as session:
        return listing.get(session, services.settings, by, submission.id), is_new


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
        return _make(services, by, upload)
    except ServiceError as error:
        made = _made_meanwhile(services, upload_id)
        if made is not None:
            return made, False
        if error.code not in _TRANSIENT:
            partial_uploads.remove(services, upload_id)
        raise


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
