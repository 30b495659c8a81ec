"""Routes of submissions: upload, read, list, cancel, follow."""

import base64
import binascii
import json
from collections.abc import AsyncIterator
from contextlib import aclosing
from http import HTTPStatus
from typing import Annotated
from uuid import UUID

from fastapi import APIRouter, Query, Request, Response
from fastapi.concurrency import run_in_threadpool
from sse_starlette import EventSourceResponse, ServerSentEvent
from starlette.requests import ClientDisconnect
from vitac.server import intake, submissions
from vitac.server.auth.principals import Principal
from vitac.server.db.states import EvaluationState, SubmissionKind
from vitac.server.errors import ProblemCode, ServiceError
from vitac.server.leaderboards import load_known_track
from vitac.server.services import Services
from vitac.server.submissions import CheckedUpload
from vitac.server.views import EpisodeView, SubmissionListView, SubmissionView

from .access import PrincipalOf, ServicesOf
from .problems import RESPONSES

router = APIRouter(prefix="/submissions", tags=["submissions"], responses=RESPONSES)

ARCHIVE_TYPE = "application/zip"
PING_S = 15
_BODY = {"required": True, "content": {ARCHIVE_TYPE: {"schema": {"type": "string", "format": "binary"}}}}


@router.post(
    "",
    status_code=HTTPStatus.ACCEPTED,
    responses={
        200: {"model": SubmissionView, "description": "This content is evaluated already; nothing was started."}
    },
    openapi_extra={"requestBody": _BODY},
)
async def post_submission(
    request: Request,
    response: Response,
    services: ServicesOf,
    principal: PrincipalOf,
    *,
    track: Annotated[str | None, Query(description="Must agree with submission.yaml.")] = None,
    kind: Annotated[SubmissionKind, Query(description="What the body is.")] = SubmissionKind.MODEL,
    team: Annotated[str | None, Query(description="For organizers: whose submission this is.")] = None,
    again: Annotated[bool, Query(description="Play all episodes anew although results are stored.")] = False,
) -> SubmissionView:
    """Uploads a zip with one folder `Track_1` and starts its evaluation.

    The body is the zip itself. A body over the limit is refused by its `Content-Length` before any of it is read (send
    `Expect: 100-continue` to be told first). `X-Content-SHA256: <hex>` or `Content-Digest: sha-256=:<base64>:` is
    verified. The same content from the same team is the same submission: 200 with it while it is evaluated or done.
    """
    _check_head(request, services, track, kind)
    with request.app.state.upload_limiter.one(principal.actor, "uploads at the same time"):
        upload = await _take_in(request, services, track)
    view, is_new = await run_in_threadpool(_create, services, principal, upload, team, again)
    response.status_code = HTTPStatus.ACCEPTED if is_new else HTTPStatus.OK
    response.headers["Location"] = f"{request.url.path}/{view.id}"
    return view


@router.get("")
def list_submissions(
    services: ServicesOf,
    principal: PrincipalOf,
    *,
    track: str | None = None,
    state: EvaluationState | None = None,
    team: Annotated[str | None, Query(description="For organizers.")] = None,
    before: Annotated[UUID | None, Query(description="`next_before` of the page before.")] = None,
    limit: Annotated[int, Query(ge=1, le=100)] = 50,
) -> SubmissionListView:
    """The team's submissions, newest first; all teams' for an organizer."""
    with services.database.transaction() as session:
        return submissions.list_submissions(
            session, services.settings, principal, track=track, state=state, team=team, before=before, limit=limit
        )


@router.get("/{submission_id}")
def get_submission(services: ServicesOf, principal: PrincipalOf, submission_id: UUID) -> SubmissionView:
    """One submission: state, place in the queue, progress, verdict, score. Another team's is answered with 404."""
    with services.database.transaction() as session:
        return submissions.get(session, services.settings, principal, submission_id)


@router.get("/{submission_id}/episodes")
def get_episodes(services: ServicesOf, principal: PrincipalOf, submission_id: UUID) -> list[EpisodeView]:
    """How each finished episode ended."""
    with services.database.transaction() as session:
        return submissions.episodes(session, principal, submission_id)


@router.post("/{submission_id}/cancel")
def cancel_submission(services: ServicesOf, principal: PrincipalOf, submission_id: UUID) -> SubmissionView:
    """Ends a queued or running evaluation. Finished episodes stay stored: uploading again takes it up."""
    with services.database.transaction() as session:
        submissions.cancel(session, principal, submission_id)
    with services.database.transaction() as session:
        return submissions.get(session, services.settings, principal, submission_id)


@router.post("/{submission_id}/requeue", status_code=HTTPStatus.ACCEPTED)
def requeue_submission(services: ServicesOf, principal: PrincipalOf, submission_id: UUID) -> SubmissionView:
    """Starts a new run that plays all episodes anew (organizers only). Earlier results stay."""
    with services.database.transaction() as session:
        submissions.run_again(session, principal, submission_id)
    with services.database.transaction() as session:
        return submissions.get(session, services.settings, principal, submission_id)


@router.get(
    "/{submission_id}/events",
    response_class=EventSourceResponse,
    responses={200: {"content": {"text/event-stream": {}}, "description": "Events `submission`, at last `end`."}},
)
async def follow_submission(
    request: Request, services: ServicesOf, principal: PrincipalOf, submission_id: UUID
) -> EventSourceResponse:
    """The submission as server-sent events: now, after each change, and `end` when its evaluation has ended."""
    # Before the stream begins, so that a foreign id is answered with 404 and not with an empty stream.
    await run_in_threadpool(get_submission, services, principal, submission_id)
    return EventSourceResponse(_events(request, services, principal, submission_id), ping=PING_S)


async def _events(
    request: Request, services: Services, principal: Principal, submission_id: UUID
) -> AsyncIterator[ServerSentEvent]:
    with request.app.state.stream_limiter.one("all", "event streams"):
        watching = submissions.watch(services.database, services.settings, principal, submission_id)
        async with aclosing(watching) as views:
            async for view in views:
                yield ServerSentEvent(view.model_dump_json(), event="submission")
        yield ServerSentEvent(json.dumps({"submission": str(submission_id)}), event="end")


def _check_head(request: Request, services: Services, track: str | None, kind: SubmissionKind) -> None:
    """Refuses by headers and query alone, before any of the body is read."""
    came = request.headers.get("content-type", "").partition(";")[0].strip().lower()
    if came != ARCHIVE_TYPE:
        raise ServiceError(
            ProblemCode.UNSUPPORTED_CONTENT_TYPE,
            f"The body must be a zip with `Content-Type: {ARCHIVE_TYPE}`; came {came or 'none'!r}.",
            supported=[ARCHIVE_TYPE],
        )
    if kind is not SubmissionKind.MODEL:
        raise ServiceError(
            ProblemCode.UNSUPPORTED_SUBMISSION_KIND, f"Submissions of kind {kind} are not taken here; send a model."
        )
    intake.check_announced_size(_announced_bytes(request), services.settings)
    if track is not None:
        load_known_track(track)


async def _take_in(request: Request, services: Services, track: str | None) -> CheckedUpload:
    with intake.upload_folder(services.settings) as folder:
        try:
            received = await intake.receive(
                request.stream(), folder, services.settings, announced_bytes=_announced_bytes(request)
            )
        except ClientDisconnect as error:
            raise intake.truncated("the connection was closed") from error
        intake.check_digest(received, _claimed_sha256(request))
        return await run_in_threadpool(intake.accept, services, received, track=track)


def _create(
    services: Services, principal: Principal, upload: CheckedUpload, team: str | None, again: bool
) -> tuple[SubmissionView, bool]:
    with services.database.transaction() as session:
        submission, is_new = submissions.create(session, principal, upload, team=team, again=again)
    with services.database.transaction() as session:
        return submissions.get(session, services.settings, principal, submission.id), is_new


def _announced_bytes(request: Request) -> int | None:
    text = request.headers.get("content-length")
    if text is None:
        return None
    if not (text.isascii() and text.isdigit()):
        raise ServiceError(ProblemCode.LENGTH_INVALID, f"Content-Length must be a number of bytes; came {text[:40]!r}.")
    return int(text)


def _claimed_sha256(request: Request) -> str | None:
    """The digest that the client sent along, as hex; either header will do."""
    plain = request.headers.get("x-content-sha256")
    if plain is not None:
        return plain.strip()
    for part in request.headers.get("content-digest", "").split(","):
        name, _, value = part.strip().partition("=")
        if name == "sha-256":
            return _hex_of(value)
    return None


def _hex_of(value: str) -> str:
    try:
        return base64.b64decode(value.strip(":"), validate=True).hex()
    except binascii.Error as error:
        raise ServiceError(
            ProblemCode.DIGEST_MISMATCH, f"Content-Digest must be sha-256=:<base64>:; came {value[:80]!r}."
        ) from error
