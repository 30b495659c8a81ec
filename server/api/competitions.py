"""Routes of competitions: what everybody may read, and for their organizers from the file to the published end."""

import io
import zipfile
from collections.abc import Sequence
from datetime import datetime
from http import HTTPStatus
from typing import Annotated, Literal
from uuid import UUID, uuid4

from fastapi import APIRouter, Query, Response
from fastapi.responses import FileResponse, StreamingResponse
from pydantic import BaseModel, Field
from sqlalchemy.orm import Session
from starlette.background import BackgroundTask
from vitac.evaluator.strict_model import DocumentRejected
from vitac.evaluator.submission_kinds import SubmissionKind

from ..accounts.teams import REASON_LENGTH
from ..competitions import applying, sealing
from ..competitions.competition import Competition
from ..competitions.definition import CompetitionDefinition, require_known_tracks
from ..competitions.view import competition_list_view, competition_view, disqualified_since_the_end
from ..confirmations import Concern, compute_revision, require_shown
from ..database.clock import read_clock
from ..decisions import advancement, finishing, station_trials
from ..decisions.exporting import export_receipts
from ..decisions.publishing import archive_view, result_files
from ..errors import ProblemCode, ServiceError
from ..submissions import final_list, stage_files
from ..views.base import View
from ..views.competition import AdvancementView, ArchiveView, CompetitionListView, CompetitionView, PlannedTrialView
from .access import ChangingServicesOf, CompetitionOrganizerOf, OrganizerOf, ServicesOf, VisitorOf
from .inputs import Input
from .problems import RESPONSES

router = APIRouter(tags=["competitions"], responses=RESPONSES)


class Decision(Input):
    """Who takes part in a stage besides or without those that its rule takes."""

    add: list[str] = Field(default=[], max_length=1000, description="Names or ids of further teams.")
    without: list[str] = Field(default=[], max_length=1000, description="Proposed teams that do not take part.")
    revision: str | None = Field(
        default=None,
        max_length=64,
        description="Of the confirmed teams as you saw them; none if there were none, and for a dry run.",
    )
    shown: str | None = Field(
        default=None, max_length=64, description="`revision` that a dry run gave; refused where others would take part."
    )


class NewDefinition(Input):
    """The content of a competition's file."""

    definition: CompetitionDefinition
    base: str | None = Field(
        default=None,
        max_length=64,
        description="`revision` that the file was made from; none for a new competition, and for a dry run.",
    )
    confirm: list[str] = Field(
        default=[], max_length=1000, description="Names of concerns that are meant; a refusal and a dry run list them."
    )


class Definition(BaseModel):
    """A competition as its file says."""

    definition: CompetitionDefinition
    revision: str = Field(description="Give this as `base` to change exactly this.")


class Applied(BaseModel):
    """What a competition's file changes."""

    changes: list[applying.Change]
    concerns: list[Concern] = Field(description="What it touches that already happened.")
    warnings: list[str] = Field(description="What takes effect at once.")
    revision: str = Field(description="Of the competition before.")


class FinalListStart(BaseModel):
    """The submissions that play a final list from now on."""

    submissions: Sequence[UUID]


class TrialsBegun(BaseModel):
    """How many trials stations play from now on."""

    trials: int


class SealedListRow(View):
    """A sealed list of a stage."""

    track: str
    stage: str
    commitment: str
    withdrawn_at: datetime | None
    revealed_at: datetime | None
    secret: str | None = Field(description="Once it is published.")


class Winners(BaseModel):
    """Who wins what: at the end, or by the present boards of the last stages."""

    items: list[finishing.Winner]
    without_winner: list[str] = Field(description="Prizes that nobody wins, a sentence for each track.")
    disqualified: list[str] = Field(description="Teams that were disqualified after the end.")
    concerns: list[Concern] = Field(description="What is not settled, and would be by the end alone.")
    revision: str = Field(description="Give this as `shown` to end the competition with exactly these.")


class FinalEnd(Input):
    """How a competition is ended."""

    confirm: list[str] = Field(
        default=[], max_length=100, description="Names of what is not settled and is meant; a refusal lists them."
    )
    again: bool = Field(
        default=False, description="Decide the winners of a final competition again, without disqualified teams."
    )
    shown: str | None = Field(
        default=None, max_length=64, description="`revision` that a dry run gave; refused where others would win."
    )


class Reopening(Input):
    """Why a final competition is reopened."""

    reason: str = Field(max_length=REASON_LENGTH, description="For everybody to read.")


@router.get("/competitions")
def list_competitions(services: ServicesOf) -> CompetitionListView:
    """Return the competitions of this service, the one that opened last first."""
    with services.database.reading() as session:
        return competition_list_view(session)


@router.get("/competitions/{competition}")
@router.get("/competition")
def get_competition(services: ServicesOf, competition: str | None = None) -> CompetitionView:
    """Return a competition: schedule, rules, prizes, commitments, at the end winners; without a name the last one."""
    with services.database.reading() as session:
        return competition_view(session, competition)


@router.get("/competitions/{competition}/archive")
@router.get("/competition/archive")
def get_archive(services: ServicesOf, competition: str | None = None) -> ArchiveView:
    """Return winners and boards as they were when a competition was finalized, and how to cite; before that 404."""
    with services.database.reading() as session:
        return archive_view(session, competition)


@router.get("/competitions/{competition}/tracks/{track}/stages/{stage}/advancement")
def get_advancement(
    services: ServicesOf, principal: CompetitionOrganizerOf, competition: str, track: str, stage: str
) -> AdvancementView:
    """Return who would advance to a stage by its rule, and who was confirmed."""
    with services.database.transaction() as session:
        return advancement.propose(
            session, principal, Competition.find(session, competition, track=track).stage(track, stage)
        )


@router.put("/competitions/{competition}/tracks/{track}/stages/{stage}/advancement")
def confirm_advancement(
    services: ChangingServicesOf,
    principal: CompetitionOrganizerOf,
    competition: str,
    track: str,
    stage: str,
    decision: Decision,
) -> AdvancementView:
    """Let the proposed teams, more of them or fewer, take part in a stage."""
    with services.database.transaction() as session:
        its_stage = Competition.find(session, competition, track=track).stage(track, stage)
        is_looked_at = services.database.is_trial or decision.shown is not None
        base = decision.revision if is_looked_at else decision.revision or ""
        advancement.confirm(session, principal, its_stage, add=decision.add, without=decision.without, base=base)
        view = advancement.propose(session, principal, its_stage)
        require_shown("the teams", decision.shown, view.revision)
        return view


@router.post("/competitions/{competition}/freeze", status_code=HTTPStatus.NO_CONTENT, response_class=Response)
def freeze(services: ChangingServicesOf, principal: CompetitionOrganizerOf, competition: str) -> None:
    """Freeze the boards of a competition for everybody but its organizers."""
    with services.database.transaction() as session:
        applying.freeze_boards(session, principal, competition)


@router.post("/competitions/{competition}/unfreeze", status_code=HTTPStatus.NO_CONTENT, response_class=Response)
def unfreeze(services: ChangingServicesOf, principal: CompetitionOrganizerOf, competition: str) -> None:
    """Show all results on the boards of a competition again."""
    with services.database.transaction() as session:
        applying.unfreeze_boards(session, principal, competition)


@router.post("/competitions/{competition}/finalize")
def finalize(
    services: ChangingServicesOf, principal: CompetitionOrganizerOf, competition: str, end: FinalEnd
) -> Winners:
    """End a competition with the winners as they are now, or decide the winners of a final one again."""
    with services.database.transaction() as session:
        if end.again:
            concerns = []
            winners_now = finishing.finalize_again(session, principal, competition)
        else:
            concerns = finishing.concerns_at_end(session, competition)
            confirmed = None if services.database.is_trial else end.confirm
            winners_now = finishing.finalize(session, principal, competition, confirmed=confirmed)
        winners = _winners(session, winners_now, concerns, competition)
        require_shown("the winners", end.shown, winners.revision)
        return winners


@router.get("/competitions/{competition}/winners")
def get_winners(services: ServicesOf, principal: CompetitionOrganizerOf, competition: str) -> Winners:  # noqa: ARG001
    """List the winners: the final ones, or those by the present boards of the last stages."""
    with services.database.transaction() as session:
        return _winners(session, finishing.winners(session, competition), [], competition)


@router.get(
    "/competitions/{competition}/results",
    response_class=Response,
    responses={200: {"content": {"application/zip": {}}, "description": "The files."}},
)
def get_results(services: ServicesOf, principal: CompetitionOrganizerOf, competition: str) -> Response:  # noqa: ARG001
    """Return the results as JSON, CSV, a page to print and certificates, in a zip."""
    with services.database.transaction() as session:
        files = result_files(session, competition)
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, text in files.items():
            archive.writestr(name, text)
    return Response(content.getvalue(), media_type="application/zip")


@router.get("/competitions/{competition}/definition")
def get_definition(
    services: ServicesOf,
    principal: CompetitionOrganizerOf,  # noqa: ARG001
    competition: str,
) -> Definition:
    """Return what a competition's file says, and its revision."""
    with services.database.transaction() as session:
        named = Competition.find(session, competition)
        return Definition(definition=named.definition, revision=named.revision)


@router.put("/competitions/{competition}/definition")
def put_definition(
    services: ChangingServicesOf, principal: CompetitionOrganizerOf, competition: str, new: NewDefinition
) -> Applied:
    """Apply a competition's file; other competitions stay as they are."""
    definition = new.definition
    if definition.name != competition:
        raise ServiceError(
            ProblemCode.INVALID_REQUEST, f"Expected a competition named {competition!r:.80}, got {definition.name!r}."
        )
    try:
        require_known_tracks(definition, "The file")
    except DocumentRejected as error:
        raise ServiceError(ProblemCode.INVALID_REQUEST, str(error)) from error
    is_trial = services.database.is_trial
    with services.database.transaction() as session:
        revision = Competition.read(session, definition.name).revision
        concerns = applying.list_concerns(session, definition)
        changes = applying.apply(
            session,
            principal,
            definition,
            base=new.base if is_trial else new.base or "",
            confirmed=None if is_trial else new.confirm,
        )
        warnings = applying.list_warnings(definition, changes, at=read_clock(session)) if changes else []
        return Applied(changes=changes, concerns=concerns, warnings=warnings, revision=revision)


@router.get("/competitions/{competition}/lists")
def list_sealed_lists(
    services: ServicesOf,
    principal: CompetitionOrganizerOf,  # noqa: ARG001
    competition: str,
) -> list[SealedListRow]:
    """List the sealed lists of stages: commitments to publish before a stage, secrets once they are revealed."""
    with services.database.transaction() as session:
        return [
            SealedListRow.from_row(each, secret=each.secret if each.revealed_at else None)
            for each in sealing.sealed_lists(session, Competition.find(session, competition))
        ]


@router.get(
    "/competitions/{competition}/tracks/{track}/stages/{stage}/submissions",
    response_class=StreamingResponse,
    responses={200: {"content": {"application/zip": {}}, "description": "An index and each upload as it was sent."}},
)
def get_stage_submissions(
    services: ServicesOf, principal: CompetitionOrganizerOf, competition: str, track: str, stage: str
) -> StreamingResponse:
    """Return all submissions of a stage in a zip, by team."""
    with services.database.reading() as session:
        its_stage = Competition.find(session, competition, track=track).stage(track, stage)
        files = stage_files.list_files(session, principal, its_stage)
    return StreamingResponse(
        stage_files.stream_zip(services.blobs, files),
        media_type="application/zip",
        headers={"Content-Disposition": f'attachment; filename="{competition}-{track}-{stage}.zip"'},
    )


@router.post("/competitions/{competition}/tracks/{track}/stages/{stage}/reveal")
def reveal_list(
    services: ChangingServicesOf, principal: CompetitionOrganizerOf, competition: str, track: str, stage: str
) -> SealedListRow:
    """Publish the secret of a stage's sealed list after the stage has closed; this cannot be undone."""
    with services.database.transaction() as session:
        over = Competition.find(session, competition, track=track).stage(track, stage)
        over.require_over()
        sealed = sealing.reveal(session, principal, over)
        session.flush()
        return SealedListRow.from_row(sealed, secret=None if services.database.is_trial else sealed.secret)


@router.post("/competitions/{competition}/tracks/{track}/stages/{stage}/final")
def play_final_list(
    services: ChangingServicesOf, principal: CompetitionOrganizerOf, competition: str, track: str, stage: str
) -> FinalListStart:
    """Have all teams' chosen submissions play the final list of a stage, once, now that the stage has closed.

    The service does so by itself within seconds of the last evaluation of the stage; this says what it waits for.
    """
    with services.database.transaction() as session:
        over = Competition.find(session, competition, track=track).stage(track, stage)
        return FinalListStart(submissions=final_list.play(session, principal, over))


@router.post("/competitions/{competition}/tracks/{track}/stages/{stage}/trials")
def begin_trials(
    services: ChangingServicesOf, principal: CompetitionOrganizerOf, competition: str, track: str, stage: str
) -> TrialsBegun:
    """Plan the trials of a stage that stations play, now that it has closed, and let them begin."""
    with services.database.transaction() as session:
        over = Competition.find(session, competition, track=track).stage(track, stage)
        return TrialsBegun(trials=station_trials.begin(session, principal, over))


@router.get("/competitions/{competition}/tracks/{track}/stages/{stage}/trials")
def list_trials(
    services: ServicesOf, principal: VisitorOf, competition: str, track: str, stage: str
) -> list[PlannedTrialView]:
    """List the planned trials of a stage in their order: a team's own; all for organizers, and once it is revealed."""
    with services.database.reading() as session:
        planned = Competition.find(session, competition, track=track).stage(track, stage)
        return station_trials.list_trials(session, principal, planned)


@router.get(
    "/leaderboards/{track}/receipts",
    response_class=FileResponse,
    responses={200: {"content": {"application/zip": {}}, "description": "The file for `vitac receipt audit`."}},
)
def export_board(
    services: ServicesOf,
    principal: OrganizerOf,  # noqa: ARG001 - says who may
    track: str,
    *,
    competition: str | None = None,
    task: Annotated[str | None, Query(description="The board of this task; by default that of all tasks.")] = None,
    stage: Annotated[str | None, Query(description="Name of the stage; by default the one that opened last.")] = None,
    kind: Annotated[
        Literal["model", "log"], Query(description="Kind of submission on the board; log only with a task.")
    ] = "model",
) -> FileResponse:
    """Write a board with receipts, records and teams' sensors for `vitac receipt audit`.

    Records and sensors of a sealed list are left out until its secret is published.
    """
    path = services.settings.scratch_dir / f"{uuid4()}.zip"
    with services.database.snapshot() as session:
        board = Competition.find(session, competition, track=track).shown_stage(track, stage)
        export_receipts(session, services.blobs, path, board, task=task, kind=SubmissionKind(kind))
    return FileResponse(path, media_type="application/zip", background=BackgroundTask(path.unlink))


@router.post("/competitions/{competition}/reopen")
def reopen(
    services: ChangingServicesOf, principal: CompetitionOrganizerOf, competition: str, reopening: Reopening
) -> CompetitionView:
    """Reopen a final competition; everybody reads the reason."""
    with services.database.transaction() as session:
        finishing.reopen(session, principal, reopening.reason, competition)
        return competition_view(session, competition)


def _winners(session: Session, winners: list[finishing.Winner], concerns: list[Concern], competition: str) -> Winners:
    out = disqualified_since_the_end(Competition.find(session, competition))
    return Winners(
        items=winners,
        without_winner=finishing.prizes_without_winner(session, winners, competition),
        disqualified=[team.team for team in out],
        concerns=concerns,
        revision=compute_revision([vars(winner) for winner in winners]),
    )
