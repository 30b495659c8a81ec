"""Routes of uploads in pieces: begin, ask for the offset, append, give up, and make the submission."""

from datetime import datetime
from http import HTTPStatus
from typing import Annotated
from uuid import UUID

from fastapi import APIRouter, Header, Request, Response
from fastapi.concurrency import run_in_threadpool
from vitac.evaluator.submission_kinds import SubmissionKind

from ...database.models import PartialUpload
from ...errors import ProblemCode, ServiceError
from ...limiter import UPLOADS
from ...principals import Principal
from ...services import Services
from ...storage.scratch import require_room
from ...submissions import creation, listing, partial_uploads, upload
from ...submissions.intake import check_file_name
from ...submissions.kinds import SERVED_KINDS, check_kind
from ...submissions.partial_uploads import UploadPlan
from ...tracks import load_known_track
from ...views.submissions import SubmissionView
from ..access import OwnerOf, ServicesOf, SubmitterOf
from ..problems import RESPONSES, problem
from . import protocol
from .protocol import PieceReceiver

router = APIRouter(prefix="/uploads", tags=["uploads"], responses=RESPONSES)

SUBMISSIONS = "/api/v1/submissions"
_PIECE = {"content": {protocol.PIECE_TYPE: {"schema": {"type": "string", "format": "binary"}}}}
_TRUE = "true"
ProtocolVersion = Annotated[str | None, Header(description=f"`{protocol.VERSION}`, in every request but OPTIONS.")]
Length = Annotated[str | None, Header(description="Length of the whole body in bytes.")]
Offset = Annotated[str | None, Header(description="First byte of the piece; how far the upload is, as HEAD says.")]
Metadata = Annotated[
    str | None,
    Header(
        description="`kind`, `track`, `competition`, `team`, `again` as for a submission, `sha256`, `filename`; base64."
    ),
]
PieceChecksum = Annotated[str | None, Header(description="`sha256` or `sha1` and the piece's digest in base64.")]


@router.options("", status_code=HTTPStatus.NO_CONTENT, response_class=Response)
def get_options(services: ServicesOf, response: Response) -> None:
    """Say which protocol, extensions and size are possible."""
    response.headers.update(
        {
            "Tus-Version": protocol.VERSION,
            "Tus-Extension": protocol.EXTENSIONS,
            "Tus-Checksum-Algorithm": ",".join(protocol.CHECKSUMS),
            "Tus-Max-Size": str(max(kind.max_bytes(services.settings) for kind in SERVED_KINDS.values())),
        }
    )


@router.post("", status_code=HTTPStatus.CREATED, response_class=Response)
def post_upload(
    request: Request,
    response: Response,
    services: ServicesOf,
    principal: SubmitterOf,
    tus_resumable: ProtocolVersion = None,  # noqa: ARG001 - these headers are read by `protocol`, and described here
    upload_length: Length = None,  # noqa: ARG001
    upload_metadata: Metadata = None,  # noqa: ARG001
) -> None:
    """Begin an upload in pieces, by the protocol tus 1.0.0. `Location` is where its pieces go.

    With `sha256` in the metadata, the team's unfinished upload of the same content is continued: `Upload-Offset` says
    where. The digest is checked when the submission is made.
    """
    metadata = protocol.read_metadata(request)
    plan = _plan(metadata, protocol.read_number(request, "Upload-Length"))
    with services.database.transaction() as session:
        owner = creation.expect_upload(
            session,
            services.settings.quotas,
            principal,
            team=metadata.get("team"),
            sha256=plan.sha256,
            track=plan.track,
            competition=plan.competition,
        )
        check_file_name(plan.file_name, team=owner.name)
        upload = partial_uploads.begin(session, services.settings, owner, plan)
    response.headers["Location"] = f"{request.url.path.rstrip('/')}/{upload.id}"
    _tell(response, upload.received_bytes, upload.expires_at)


@router.head("/{upload_id}", response_class=Response)
def head_upload(
    response: Response,
    services: ServicesOf,
    principal: OwnerOf,
    upload_id: UUID,
    tus_resumable: ProtocolVersion = None,  # noqa: ARG001
) -> None:
    """Send in `Upload-Offset` where the upload continues."""
    upload = _find(services, principal, upload_id)
    response.headers.update({"Upload-Length": str(upload.total_bytes), "Cache-Control": "no-store"})
    _tell(response, upload.received_bytes, upload.expires_at)


@router.patch(
    "/{upload_id}", status_code=HTTPStatus.NO_CONTENT, response_class=Response, openapi_extra={"requestBody": _PIECE}
)
async def patch_upload(
    request: Request,
    services: ServicesOf,
    principal: OwnerOf,
    upload_id: UUID,
    tus_resumable: ProtocolVersion = None,  # noqa: ARG001
    upload_offset: Offset = None,  # noqa: ARG001
    upload_checksum: PieceChecksum = None,  # noqa: ARG001
) -> Response:
    """Add a piece of any length. If it is cut off, what has arrived counts; with `Upload-Checksum` only the whole."""
    announced = request.headers.get("content-type", "").partition(";")[0].strip().lower()
    if announced != protocol.PIECE_TYPE:
        raise ServiceError(
            ProblemCode.UNSUPPORTED_CONTENT_TYPE,
            f"Expected `Content-Type: {protocol.PIECE_TYPE}`, got {announced or 'none'!r}.",
        )
    offset, checksum = protocol.read_number(request, "Upload-Offset"), protocol.read_checksum(request)
    upload = await run_in_threadpool(_find, services, principal, upload_id)
    if offset != upload.received_bytes:
        raise await run_in_threadpool(_conflict, services, upload_id, offset)
    require_room(services.settings, upload.total_bytes - offset)
    receiver = PieceReceiver(
        services=services,
        upload_id=upload_id,
        offset=offset,
        end=upload.total_bytes,
        checksum=checksum,
        expires_at=upload.expires_at,
    )
    with request.app.state.upload_limiter.one(principal.account, UPLOADS):
        try:
            await receiver.receive(request.stream())
        except ServiceError as error:
            if error.code is not ProblemCode.CHECKSUM_MISMATCH:
                raise
            return problem(request, error, status=protocol.CHECKSUM_MISMATCH_STATUS)
    response = Response(status_code=HTTPStatus.NO_CONTENT)
    _tell(response, receiver.offset, receiver.expires_at)
    return response


@router.delete("/{upload_id}", status_code=HTTPStatus.NO_CONTENT, response_class=Response)
def delete_upload(
    services: ServicesOf,
    principal: OwnerOf,
    upload_id: UUID,
    tus_resumable: ProtocolVersion = None,  # noqa: ARG001
) -> None:
    """Give up an upload and remove its parts."""
    _find(services, principal, upload_id)
    partial_uploads.remove(services, upload_id)


@router.post(
    "/{upload_id}/submission",
    status_code=HTTPStatus.ACCEPTED,
    responses={
        200: {"model": SubmissionView, "description": "This content is evaluated already; nothing was started."}
    },
)
def post_submission_of_upload(
    request: Request, response: Response, services: ServicesOf, principal: OwnerOf, upload_id: UUID
) -> SubmissionView:
    """Check a complete upload, as a body sent at once is checked, and start its evaluation. May be repeated."""
    with request.app.state.upload_limiter.one(principal.account, UPLOADS):
        submission_id, is_new = upload.complete(services, principal, upload_id)
    with services.database.transaction() as session:
        view = listing.get(session, services.settings, principal, submission_id)
    response.status_code = HTTPStatus.ACCEPTED if is_new else HTTPStatus.OK
    response.headers["Location"] = f"{SUBMISSIONS}/{view.id}"
    return view


def _plan(metadata: dict[str, str], total_bytes: int) -> UploadPlan:
    kind_name, track, sha256 = metadata.get("kind", SubmissionKind.MODEL), metadata.get("track"), metadata.get("sha256")
    if kind_name not in set(SubmissionKind):
        raise ServiceError(
            ProblemCode.INVALID_REQUEST, f"Expected kind {' or '.join(SubmissionKind)}, got {kind_name!r:.40}."
        )
    kind = SubmissionKind(kind_name)
    if track is not None:
        check_kind(kind, load_known_track(track))
    if sha256 is not None and not protocol.SHA256.fullmatch(sha256):
        raise ServiceError(ProblemCode.INVALID_REQUEST, f"Expected sha256 as 64 hex digits, got {sha256!r:.80}.")
    if total_bytes == 0:
        raise ServiceError(ProblemCode.LENGTH_INVALID, "Expected an upload of at least one byte, got Upload-Length: 0.")
    again = metadata.get("again") == _TRUE
    return UploadPlan(
        kind=kind,
        track=track,
        competition=metadata.get("competition"),
        again=again,
        file_name=metadata.get("filename"),
        total_bytes=total_bytes,
        sha256=sha256,
    )


def _find(services: Services, principal: Principal, upload_id: UUID) -> PartialUpload:
    with services.database.transaction() as session:
        return partial_uploads.find(session, principal, upload_id)


def _conflict(services: Services, upload_id: UUID, offset: int) -> ServiceError:
    with services.database.transaction() as session:
        return partial_uploads.conflict(session, upload_id, offset)


def _tell(response: Response, offset: int, expires_at: datetime) -> None:
    response.headers.update({"Upload-Offset": str(offset), "Upload-Expires": protocol.http_date(expires_at)})
