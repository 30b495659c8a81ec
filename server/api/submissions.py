"""Routes of submissions: upload, read, list, cancel, follow."""

import base64
import binascii
import json
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import aclosing
from http import HTTPStatus
from typing import Annotated
from uuid import UUID

from fastapi import APIRouter, Query, Request, Response
from fastapi.concurrency import run_in_threadpool
from pydantic import Field
from sse_starlette import EventSourceResponse, ServerSentEvent
from vitac.evaluator.submission_kinds import SubmissionKind

from ..accounts.teams import REASON_LENGTH
from ..database.states import EvaluationState
from ..evaluations import action_matches
from ..evaluations.logs import export_log
from ..leaderboards import descriptions, public_pages
from ..limiter import UPLOADS
from ..names import TEXT_LENGTH
from ..principals import Principal
from ..services import Services
from ..submissions import files, final_list, listing, runs, sensors, trials, upload, withdrawal
from ..submissions.comparison import MAX_COMPARED, compare_results
from ..submissions.intake import AnnouncedUpload
from ..submissions.listing import model_card
from ..submissions.watch import SubmissionWatch, watch
from ..views.comparisons import ComparisonView
from ..views.receipts import ActionMatchView
from ..views.submissions import (
    DescriptionView,
    EpisodeView,
    ModelCardView,
    OutputView,
    SensorView,
    SubmissionListView,
    SubmissionView,
)
from ..views.trials import TrialView
from ..visibility import visible
from .access import (
    MAX_NUMBER,
    ChangingServicesOf,
    CompetitionOrganizerOf,
    OwnerOf,
    PublicReaderOf,
    ReaderOf,
    RowNumber,
    ServicesOf,
    SignedInOf,
    SubmitterOf,
    VisitorOf,
)
from .inputs import Input
from .problems import RESPONSES
from .streams import CountedStream, OpenStreams
from .uploads import read_number, require_type

router = APIRouter(prefix="/submissions", tags=["submissions"], responses=RESPONSES)
comparisons = APIRouter(prefix="/comparisons", tags=["submissions"], responses=RESPONSES)

VIDEO_TYPE = "video/x-motion-jpeg"
LOG_TYPE = SubmissionKind.LOG.form.content_types[0]
PING_S = 15
_BINARY = {"schema": {"type": "string", "format": "binary"}}
_BODY = {"required": True, "content": {name: _BINARY for kind in SubmissionKind for name in kind.form.content_types}}


class Publicity(Input):
    """Who may see the result of a submission."""

    public: bool = Field(description="Everybody; else its team, judges and organizers.")


class Choice(Input):
    """Whether a submission plays the final list of its stage."""

    chosen: bool


class Description(Input):
    """What is written about a public result; with nothing in it, what was written is removed."""

    text: str = Field(default="", description=f"Plain text of at most {TEXT_LENGTH} characters.")
    code: str = Field(default="", description="https address of the code.")
    paper: str = Field(default="", description="https address of the paper.")
    discussion: str = Field(default="", description="https address of a place to discuss it.")
    base: str | None = Field(
        default=None, description="`revision` that the change was made against; refused if there is another one now."
    )


class Reason(Input):
    """Why organizers decide something about a submission."""

    reason: str = Field(max_length=REASON_LENGTH, description="In one line, for the team.")


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
    principal: SubmitterOf,
    *,
    track: Annotated[str | None, Query(description="Must agree with submission.yaml or the log's header.")] = None,
    competition: Annotated[
        str | None, Query(description="Name of the competition; needed where several take submissions to the track.")
    ] = None,
    kind: Annotated[SubmissionKind, Query(description="Kind of submission in the body.")] = SubmissionKind.MODEL,
    team: Annotated[str | None, Query(description="For organizers: the team that submits.")] = None,
    file_name: Annotated[
        str | None,
        Query(
            max_length=255,
            description="Name of the file; one in the challenge's form must agree with team, track and stage.",
        ),
    ] = None,
    again: Annotated[bool, Query(description="Run all episodes again, including stored ones.")] = False,
) -> SubmissionView:
    """Upload a submission and start its evaluation.

    The body of a `model` is a zip with one folder, the track's own. Where the track takes them, the body of a `log`
    is what `vitac evaluate --log` writes, and that of a `text_log` a log of the 2025 challenge; either may be gzip.
    Logs are re-simulated from their actions and rank apart: `log` in the answer has the verdict.

    A body over the limit is refused by its `Content-Length` before any of it is read (send
    `Expect: 100-continue` to get the answer first). `X-Content-SHA256: <hex>` or `Content-Digest: sha-256=:<base64>:`
    is verified. The same content from the same team is the same submission: 200 with it while it is evaluated or done.
    """
    require_type(request, kind.form.content_types, f"a {kind}")
    announced = AnnouncedUpload(
        kind=kind,
        track=track,
        competition=competition,
        team=team,
        again=again,
        total_bytes=read_number(request, "Content-Length") if "content-length" in request.headers else None,
        sha256=_claimed_sha256(request),
        file_name=file_name,
    )
    with request.app.state.upload_limiter.one(principal.account, UPLOADS):
        view, is_new = await upload.receive(services, principal, announced, request.stream())
    response.status_code = HTTPStatus.ACCEPTED if is_new else HTTPStatus.OK
    response.headers["Location"] = f"{request.url.path}/{view.id}"
    return view


@router.get("")
def list_submissions(
    services: ServicesOf,
    principal: SignedInOf,
    *,
    competition: Annotated[str | None, Query(description="Only submissions to the competition of this name.")] = None,
    track: str | None = None,
    state: EvaluationState | None = None,
    team: Annotated[str | None, Query(description="For organizers.")] = None,
    before: Annotated[UUID | None, Query(description="`next_before` from the previous page.")] = None,
    limit: Annotated[int, Query(ge=1, le=100)] = 50,
) -> SubmissionListView:
    """Return the team's submissions, newest first; all teams' for an organizer."""
    with services.database.reading() as session:
        return listing.list_submissions(
            session,
            services.settings,
            principal,
            competition=competition,
            track=track,
            state=state,
            team=team,
            before=before,
            limit=limit,
        )


@router.get("/{submission_id}")
def get_submission(services: ServicesOf, principal: PublicReaderOf, submission_id: UUID) -> SubmissionView:
    """Return a submission: state, place in the queue, progress, verdict, score.

    One that is public and complete is for everybody; every other one of another team is answered with 404.
    """
    with services.database.reading() as session:
        return listing.get(session, services.settings, principal, submission_id)


@router.get("/{submission_id}/episodes")
def get_episodes(
    services: ServicesOf,
    principal: PublicReaderOf,
    submission_id: UUID,
    practice: Annotated[
        bool, Query(description="Episodes of the public list that was played beside a sealed one.")
    ] = False,
) -> Sequence[EpisodeView]:
    """Return how each finished episode ended, also of a public submission; none while the list is sealed."""
    with services.database.reading() as session:
        return listing.episodes(session, principal, submission_id, practice=practice)


@router.get("/{submission_id}/output")
def get_output(
    services: ServicesOf,
    principal: ReaderOf,
    submission_id: UUID,
    *,
    task: Annotated[str | None, Query(description="One of the submission's tasks; the first by default.")] = None,
    after: Annotated[int, Query(ge=0, le=MAX_NUMBER, description="`next_after` from the previous page.")] = 0,
    limit: Annotated[int, Query(ge=1, le=100)] = files.PAGE_EPISODES,
) -> OutputView:
    """Return the end of what the policy printed in each episode, and why it failed in some.

    For its team and organizers, not of sealed lists.
    """
    with services.database.transaction() as session:
        return files.episode_outputs(session, principal, submission_id, task, after=after, limit=limit)


@router.get("/{submission_id}/sensor")
def get_sensor(services: ServicesOf, principal: ReaderOf, submission_id: UUID) -> SensorView:
    """Return the sensor of a submission: its mesh, its document, and what sensing adds once both runs are complete."""
    with services.database.transaction() as session:
        return sensors.sensor(session, principal, visible(session, principal, submission_id))


@router.get(
    "/{submission_id}/document",
    response_class=Response,
    responses={200: {"content": {"application/octet-stream": {}}, "description": "The file as it was uploaded."}},
)
def get_document(services: ServicesOf, principal: ReaderOf, submission_id: UUID) -> Response:
    """Return the design document, to be saved and never shown: nobody has looked at what is in it."""
    with services.database.transaction() as session:
        document = sensors.document(session, principal, submission_id)
    return Response(services.blobs.read(document.sha256), headers=sensors.to_save(submission_id, document))


@router.get("/{submission_id}/action-matches")
def get_action_matches(services: ServicesOf, principal: ReaderOf, submission_id: UUID) -> list[ActionMatchView]:
    """Return how many of a verified log's actions each later model of the team gives; none for all but a log."""
    with services.database.reading() as session:
        return action_matches.action_matches(session, principal, submission_id)


@router.get(
    "/{submission_id}/log",
    response_class=Response,
    responses={200: {"content": {LOG_TYPE: {}}, "description": "The log, one JSON object a line."}},
)
def get_log(
    services: ServicesOf,
    principal: ReaderOf,
    submission_id: UUID,
    task: Annotated[
        str | None, Query(description="Name of the task; needed where the submission plays several.")
    ] = None,
) -> Response:
    """Return what was played, as `vitac evaluate --log` writes it: enough to play it again without the policy."""
    with services.database.transaction() as session:
        content = export_log(session, principal, submission_id, task)
    name = f"{submission_id}-{task or 'log'}.jsonl"
    return Response(content, media_type=LOG_TYPE, headers={"Content-Disposition": f'attachment; filename="{name}"'})


@router.get("/{submission_id}/trials/{task}/{episode}")
def get_trial(
    services: ServicesOf, principal: PublicReaderOf, submission_id: UUID, task: str, episode: RowNumber
) -> TrialView:
    """Return a trial that a station has played: a team's own, and all once the list is published."""
    with services.database.reading() as session:
        return trials.find_trial(session, principal, submission_id, task, episode)


@router.get(
    "/{submission_id}/trials/{task}/{episode}/video",
    response_class=Response,
    responses={200: {"content": {VIDEO_TYPE: {}}, "description": "The file for `vitac station verify`."}},
)
def get_trial_video(
    services: ServicesOf, principal: PublicReaderOf, submission_id: UUID, task: str, episode: RowNumber
) -> Response:
    """Return the video of a trial as the station recorded it."""
    with services.database.reading() as session:
        video = trials.find_video(session, principal, submission_id, task, episode)
    headers = {"Content-Disposition": f'attachment; filename="{submission_id}-{video.name}"'}
    return Response(services.blobs.read(video.sha256), media_type=VIDEO_TYPE, headers=headers)


@router.put("/{submission_id}/public")
def put_public(
    services: ChangingServicesOf, principal: OwnerOf, submission_id: UUID, wanted: Publicity
) -> SubmissionView:
    """Let everybody see the result of a submission, once its evaluation is complete, or its team only."""
    return _show_changed(services, principal, submission_id, public_pages.set_public, public=wanted.public)


@router.put("/{submission_id}/chosen")
def put_chosen(services: ChangingServicesOf, principal: OwnerOf, submission_id: UUID, wanted: Choice) -> SubmissionView:
    """Let a submission play the final list of its stage after the close, or no longer.

    A stage says how many a team may choose, mostly one: of more the newest choices count. Of a team that chooses fewer,
    the best submissions on the live list play, too.
    """
    return _show_changed(services, principal, submission_id, final_list.choose, chosen=wanted.chosen)


@router.get("/{submission_id}/description")
def get_description(services: ServicesOf, principal: PublicReaderOf, submission_id: UUID) -> DescriptionView:
    """Return what the team wrote about a result; others see nothing while teams are anonymous."""
    with services.database.reading() as session:
        return descriptions.find_description(session, principal, submission_id)


@router.put("/{submission_id}/description")
def put_description(
    services: ChangingServicesOf, principal: OwnerOf, submission_id: UUID, wanted: Description
) -> DescriptionView:
    """Write about a public result of your team: a text, and links to code, paper and a place to discuss it."""
    with services.database.transaction() as session:
        descriptions.describe(session, principal, submission_id, **wanted.model_dump())
        return descriptions.find_description(session, principal, submission_id)


@router.put("/{submission_id}/description/removal")
def put_removal(
    services: ChangingServicesOf, principal: CompetitionOrganizerOf, submission_id: UUID, wanted: Reason
) -> SubmissionView:
    """Hide what a team wrote about a result from others (organizers only)."""
    return _show_changed(services, principal, submission_id, descriptions.remove, reason=wanted.reason)


@router.delete("/{submission_id}/description/removal")
def delete_removal(
    services: ChangingServicesOf, principal: CompetitionOrganizerOf, submission_id: UUID
) -> SubmissionView:
    """Let others see a removed description again (organizers only)."""
    return _show_changed(services, principal, submission_id, descriptions.restore)


@router.get("/{submission_id}/card")
def get_model_card(services: ServicesOf, principal: PublicReaderOf, submission_id: UUID) -> ModelCardView:
    """Return what a model is: its framework, size, observations and time, as far as the service knows them."""
    with services.database.reading() as session:
        return model_card(session, principal, submission_id)


@router.post("/{submission_id}/cancel")
def cancel_submission(services: ChangingServicesOf, principal: OwnerOf, submission_id: UUID) -> SubmissionView:
    """End a queued or running evaluation. Finished episodes stay stored: uploading again takes it up."""
    return _show_changed(services, principal, submission_id, runs.cancel)


@router.put("/{submission_id}/withdrawal")
def put_withdrawal(services: ChangingServicesOf, principal: OwnerOf, submission_id: UUID) -> SubmissionView:
    """Take an own submission off all boards, and cancel what waits or runs of it. Quotas stay used."""
    return _show_changed(services, principal, submission_id, withdrawal.withdraw)


@router.delete("/{submission_id}/withdrawal")
def delete_withdrawal(services: ChangingServicesOf, principal: OwnerOf, submission_id: UUID) -> SubmissionView:
    """Put a withdrawn submission back on the boards."""
    return _show_changed(services, principal, submission_id, withdrawal.restore)


@router.delete("/{submission_id}")
def delete_submission(services: ChangingServicesOf, principal: OwnerOf, submission_id: UUID) -> SubmissionView:
    """Withdraw an own submission and remove its upload, description and output permanently; its scores stay."""
    return _show_changed(services, principal, submission_id, withdrawal.erase)


@router.put("/{submission_id}/disqualification")
def put_disqualification(
    services: ChangingServicesOf, principal: CompetitionOrganizerOf, submission_id: UUID, wanted: Reason
) -> SubmissionView:
    """Take a submission off all boards (organizers only); its team takes part as before."""
    return _show_changed(services, principal, submission_id, withdrawal.disqualify, reason=wanted.reason)


@router.delete("/{submission_id}/disqualification")
def delete_disqualification(
    services: ChangingServicesOf, principal: CompetitionOrganizerOf, submission_id: UUID
) -> SubmissionView:
    """Put a disqualified submission back on the boards (organizers only)."""
    return _show_changed(services, principal, submission_id, withdrawal.reinstate)


@router.put("/{submission_id}/clearance")
def put_clearance(
    services: ChangingServicesOf, principal: CompetitionOrganizerOf, submission_id: UUID, wanted: Reason
) -> SubmissionView:
    """Rank a submission that was found to be a copy (organizers only)."""
    return _show_changed(services, principal, submission_id, withdrawal.clear_copy, reason=wanted.reason)


@router.delete("/{submission_id}/clearance")
def delete_clearance(
    services: ChangingServicesOf, principal: CompetitionOrganizerOf, submission_id: UUID
) -> SubmissionView:
    """Let what was found of a cleared submission count again (organizers only)."""
    return _show_changed(services, principal, submission_id, withdrawal.withdraw_clearance)


@router.post("/{submission_id}/requeue", status_code=HTTPStatus.ACCEPTED)
def requeue_submission(
    services: ChangingServicesOf, principal: CompetitionOrganizerOf, submission_id: UUID
) -> SubmissionView:
    """Start a new run of all episodes (organizers only). Earlier results stay."""
    return _show_changed(services, principal, submission_id, runs.run_again)


@router.get(
    "/{submission_id}/events",
    response_class=EventSourceResponse,
    responses={200: {"content": {"text/event-stream": {}}, "description": "Events `submission`, at last `end`."}},
)
async def follow_submission(
    request: Request, services: ServicesOf, principal: ReaderOf, submission_id: UUID
) -> EventSourceResponse:
    """Return the submission as server-sent events: now, after each change, and `end` when its evaluation has ended."""
    # Before the stream begins, so that a foreign id is answered with 404 and not with an empty stream.
    await run_in_threadpool(_require_own, services, principal, submission_id)
    streams = OpenStreams.from_request(request, services)
    return CountedStream(streams, principal, _events(request, services, principal, submission_id), ping=PING_S)


@comparisons.get("")
def get_comparison(
    services: ServicesOf,
    principal: VisitorOf,
    submission: Annotated[list[UUID], Query(min_length=1, max_length=MAX_COMPARED, description="Id of each.")],
) -> ComparisonView:
    """Return results beside each other; of submissions that you may not see, what leaderboards show of them."""
    with services.database.reading() as session:
        return compare_results(session, services.settings, principal, submission)


def _show_changed(
    services: Services, principal: Principal, submission_id: UUID, change: Callable[..., object], **values: object
) -> SubmissionView:
    """Change a submission and return it as it is then."""
    with services.database.transaction() as session:
        change(session, principal, submission_id, **values)
        session.flush()
        return listing.get(session, services.settings, principal, submission_id)


def _require_own(services: Services, principal: Principal, submission_id: UUID) -> None:
    """Refuse whoever may not see a submission before it is complete, also if it is public."""
    with services.database.transaction() as session:
        visible(session, principal, submission_id)


async def _events(
    request: Request, services: Services, principal: Principal, submission_id: UUID
) -> AsyncIterator[ServerSentEvent]:
    changes: SubmissionWatch = request.app.state.changes
    watching = watch(services.database, services.settings, principal, submission_id, changes)
    async with aclosing(watching) as views:
        async for view in views:
            yield ServerSentEvent(view.model_dump_json(), event="submission")
    yield ServerSentEvent(json.dumps({"submission": str(submission_id)}), event="end")


def _claimed_sha256(request: Request) -> str | None:
    """Return the digest that the client sent along, as hex; either header will do."""
    plain = request.headers.get("x-content-sha256")
    if plain is not None:
        return plain.strip().lower()
    for part in request.headers.get("content-digest", "").split(","):
        name, _, value = part.strip().partition("=")
        if name == "sha-256":
            return _parse_hex(value)
    return None


def _parse_hex(value: str) -> str:
    try:
        return base64.b64decode(value.strip(":"), validate=True).hex()
    except binascii.Error:
        return value
