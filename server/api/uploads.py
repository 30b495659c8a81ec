"""Uploads in pieces by the protocol tus 1.0.0 (https://tus.io/protocols), and the submission made of one.

Core, with the extensions creation, termination, expiration and checksum.
"""

import base64
import binascii
from collections.abc import Sequence
from datetime import UTC, datetime
from email.utils import format_datetime
from http import HTTPStatus
from typing import Annotated, Final
from uuid import UUID

from fastapi import APIRouter, Header, Request, Response
from fastapi.concurrency import run_in_threadpool
from starlette.datastructures import MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from vitac.evaluator.submission_kinds import SubmissionKind

from ..database.models import PartialUpload
from ..errors import ProblemCode, ServiceError
from ..limiter import UPLOADS
from ..principals import Principal
from ..services import Services
from ..storage.scratch import require_room
from ..submissions import listing, partial_uploads, upload
from ..submissions.intake import AnnouncedUpload
from ..submissions.kinds import SERVED_KINDS
from ..submissions.pieces import CHECKSUMS, Checksum, PieceReceiver
from ..views.submissions import SubmissionView
from .access import OwnerOf, ServicesOf, SubmitterOf
from .middleware.requests import HttpMiddleware, when_answered
from .problems import RESPONSES, problem

VERSION: Final = "1.0.0"
EXTENSIONS: Final = "creation,termination,expiration,checksum"
PIECE_TYPE: Final = "application/offset+octet-stream"
CHECKSUM_MISMATCH_STATUS: Final = 460
"""The protocol's own status, which no registry lists."""
SUBMISSIONS: Final = "/api/v1/submissions"
router = APIRouter(prefix="/uploads", tags=["uploads"], responses=RESPONSES)

_PIECE = {"content": {PIECE_TYPE: {"schema": {"type": "string", "format": "binary"}}}}
Version = Annotated[str | None, Header(description=f"`{VERSION}`, in every request but OPTIONS.")]
Length = Annotated[str | None, Header(description="Length of the whole body in bytes.")]
Offset = Annotated[str | None, Header(description="First byte of the piece; how far the upload is, as HEAD says.")]
Metadata = Annotated[
    str | None,
    Header(
        description="`kind`, `track`, `competition`, `team`, `again` as for a submission, `sha256`, `filename`; base64."
    ),
]
PieceChecksum = Annotated[str | None, Header(description="`sha256` or `sha1` and the piece's digest in base64.")]


class ProtocolVersion(HttpMiddleware):
    """ASGI middleware: below a path, requests name the version that we speak, and every answer does."""

    def __init__(self, app: ASGIApp, prefix: str) -> None:
        super().__init__(app)
        self._prefix = prefix

    async def handle(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Hand the request on, or answer 412."""
        if not f"{scope['path']}/".startswith(f"{self._prefix}/"):
            await self._app(scope, receive, send)
            return

        def name_version(message: Message) -> None:
            MutableHeaders(scope=message)["Tus-Resumable"] = VERSION

        send_with_version = when_answered(send, name_version)
        named = Request(scope).headers.get("tus-resumable")
        if scope["method"] in {"OPTIONS", "GET"} or scope["path"].endswith("/submission") or named == VERSION:
            await self._app(scope, receive, send_with_version)
            return
        refusal = ServiceError(
            ProblemCode.WRONG_PROTOCOL_VERSION,
            f"Expected the header Tus-Resumable: {VERSION}, got {named or 'none'!r}.",
        )
        answer = problem(Request(scope), refusal, {"Tus-Version": VERSION, "Connection": "close"})
        await answer(scope, receive, send_with_version)


@router.options("", status_code=HTTPStatus.NO_CONTENT, response_class=Response)
def get_options(services: ServicesOf, response: Response) -> None:
    """Say which protocol, extensions and size are possible."""
    response.headers.update(
        {
            "Tus-Version": VERSION,
            "Tus-Extension": EXTENSIONS,
            "Tus-Checksum-Algorithm": ",".join(CHECKSUMS),
            "Tus-Max-Size": str(max(kind.max_bytes(services.settings) for kind in SERVED_KINDS.values())),
        }
    )


@router.post("", status_code=HTTPStatus.CREATED, response_class=Response)
def post_upload(
    request: Request,
    response: Response,
    services: ServicesOf,
    principal: SubmitterOf,
    tus_resumable: Version = None,  # noqa: ARG001 - these headers are read below, and described here
    upload_length: Length = None,  # noqa: ARG001
    upload_metadata: Metadata = None,  # noqa: ARG001
) -> None:
    """Begin an upload in pieces, by the protocol tus 1.0.0. `Location` is where its pieces go.

    With `sha256` in the metadata, the team's unfinished upload of the same content is continued: `Upload-Offset` says
    where. The digest is checked when the submission is made.
    """
    announced = _announce(read_metadata(request), read_number(request, "Upload-Length"))
    partial = upload.begin(services, principal, announced, is_resumable=True)
    response.headers["Location"] = f"{request.url.path.rstrip('/')}/{partial.id}"
    _tell(response, partial.received_bytes, partial.expires_at)


@router.head("/{upload_id}", response_class=Response)
def head_upload(
    response: Response,
    services: ServicesOf,
    principal: OwnerOf,
    upload_id: UUID,
    tus_resumable: Version = None,  # noqa: ARG001
) -> None:
    """Send in `Upload-Offset` where the upload continues."""
    partial = _find(services, principal, upload_id)
    response.headers.update({"Upload-Length": str(partial.total_bytes), "Cache-Control": "no-store"})
    _tell(response, partial.received_bytes, partial.expires_at)


@router.patch(
    "/{upload_id}", status_code=HTTPStatus.NO_CONTENT, response_class=Response, openapi_extra={"requestBody": _PIECE}
)
async def patch_upload(
    request: Request,
    services: ServicesOf,
    principal: OwnerOf,
    upload_id: UUID,
    tus_resumable: Version = None,  # noqa: ARG001
    upload_offset: Offset = None,  # noqa: ARG001
    upload_checksum: PieceChecksum = None,  # noqa: ARG001
) -> Response:
    """Add a piece of any length. If it is cut off, what has arrived counts; with `Upload-Checksum` only the whole."""
    require_type(request, [PIECE_TYPE], "a piece")
    offset, checksum = read_number(request, "Upload-Offset"), read_checksum(request)
    partial = await run_in_threadpool(_find, services, principal, upload_id)
    if offset != partial.received_bytes:
        raise await run_in_threadpool(_conflict, services, upload_id, offset)
    require_room(services.settings, partial.total_bytes - offset)
    receiver = PieceReceiver(
        services=services,
        upload_id=upload_id,
        offset=offset,
        end=partial.total_bytes,
        checksum=checksum,
        expires_at=partial.expires_at,
    )
    with request.app.state.upload_limiter.one(principal.account, UPLOADS):
        try:
            await receiver.receive(request.stream())
        except ServiceError as error:
            if error.code is not ProblemCode.CHECKSUM_MISMATCH:
                raise
            return problem(request, error, status=CHECKSUM_MISMATCH_STATUS)
    response = Response(status_code=HTTPStatus.NO_CONTENT)
    _tell(response, receiver.offset, receiver.expires_at)
    return response


@router.delete("/{upload_id}", status_code=HTTPStatus.NO_CONTENT, response_class=Response)
def delete_upload(
    services: ServicesOf,
    principal: OwnerOf,
    upload_id: UUID,
    tus_resumable: Version = None,  # noqa: ARG001
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


def _announce(metadata: dict[str, str], total_bytes: int) -> AnnouncedUpload:
    kind = metadata.get("kind", SubmissionKind.MODEL)
    if kind not in set(SubmissionKind):
        raise ServiceError(
            ProblemCode.INVALID_REQUEST, f"Expected kind {' or '.join(SubmissionKind)}, got {kind!r:.40}."
        )
    return AnnouncedUpload(
        kind=SubmissionKind(kind),
        track=metadata.get("track"),
        competition=metadata.get("competition"),
        team=metadata.get("team"),
        again=metadata.get("again") == "true",
        file_name=metadata.get("filename"),
        total_bytes=total_bytes,
        sha256=metadata.get("sha256"),
    )


def _find(services: Services, principal: Principal, upload_id: UUID) -> PartialUpload:
    with services.database.transaction() as session:
        return partial_uploads.find(session, principal, upload_id)


def _conflict(services: Services, upload_id: UUID, offset: int) -> ServiceError:
    with services.database.transaction() as session:
        return partial_uploads.conflict(session, upload_id, offset)


def _tell(response: Response, offset: int, expires_at: datetime) -> None:
    response.headers.update({"Upload-Offset": str(offset), "Upload-Expires": http_date(expires_at)})


def read_number(request: Request, name: str) -> int:
    """Return a header that holds a number of bytes.

    Raises:
        ServiceError: it is missing or no such number.
    """
    text = request.headers.get(name, "")
    if not (text.isascii() and text.isdigit() and len(text) < 19):
        raise ServiceError(ProblemCode.LENGTH_INVALID, f"Expected {name} in bytes, got {text[:40] or 'none'!r}.")
    return int(text)


def require_type(request: Request, types: Sequence[str], what: str) -> None:
    """Refuse a body that is announced as something else.

    Raises:
        ServiceError: unsupported_content_type.
    """
    announced = request.headers.get("content-type", "").partition(";")[0].strip().lower()
    if announced not in types:
        raise ServiceError(
            ProblemCode.UNSUPPORTED_CONTENT_TYPE,
            f"Expected `Content-Type: {'` or `'.join(types)}` for {what}, got {announced or 'none'!r}.",
            supported=list(types),
        )


def read_metadata(request: Request) -> dict[str, str]:
    """Return what Upload-Metadata says: names, each with a value in base64.

    Raises:
        ServiceError: it has another form.
    """
    metadata: dict[str, str] = {}
    for pair in filter(None, (part.strip() for part in request.headers.get("upload-metadata", "").split(","))):
        name, _, value = pair.partition(" ")
        try:
            text = base64.b64decode(value.strip(), validate=True).decode()
        except (binascii.Error, UnicodeDecodeError):
            text = "\0"
        if "\0" in text or name in metadata:
            raise ServiceError(
                ProblemCode.INVALID_REQUEST, f"Expected Upload-Metadata as `name base64,...`, got {pair!r:.80}."
            )
        metadata[name] = text
    return metadata


def read_checksum(request: Request) -> Checksum | None:
    """Return what Upload-Checksum says.

    Raises:
        ServiceError: unknown algorithm, or no base64.
    """
    given = request.headers.get("upload-checksum")
    if given is None:
        return None
    algorithm, _, value = given.partition(" ")
    try:
        digest = base64.b64decode(value.strip(), validate=True)
    except binascii.Error:
        digest = b""
    if algorithm not in CHECKSUMS or not digest:
        raise ServiceError(
            ProblemCode.INVALID_REQUEST,
            f"Expected Upload-Checksum as `{'|'.join(CHECKSUMS)} base64`, got {given!r:.80}.",
        )
    return Checksum(algorithm=algorithm, digest=digest)


def http_date(moment: datetime) -> str:
    """Return a time as HTTP headers have it."""
    return format_datetime(moment.astimezone(UTC), usegmt=True)
