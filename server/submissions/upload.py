"""Makes a submission out of a body that arrives at once; called by the API's upload route and the upload page."""

import asyncio
from collections.abc import AsyncIterator
from dataclasses import dataclass, replace

from starlette.requests import ClientDisconnect
from vitac.evaluator.submission_kinds import SubmissionKind

from ..principals import Principal
from ..services import Services
from ..storage.scratch import require_room
from ..storage.stored_files import require_stored
from ..tracks import load_known_track
from ..uploads import intake
from ..uploads.acceptance import accept, check_kind, remove_unnamed, removed_if_refused
from ..uploads.checked_upload import CheckedUpload
from ..uploads.file_names import check_file_name
from ..uploads.kinds import SERVED_KINDS
from ..views.submissions import SubmissionView
from . import creation, listing


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
