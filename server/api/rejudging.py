"""Routes of rejudgements, for organizers: submissions evaluated again beside their results, applied or discarded."""

from http import HTTPStatus
from uuid import UUID

from fastapi import APIRouter, Response
from pydantic import Field

from ..competitions.competition import Competition
from ..decisions import rejudging
from ..decisions.rejudging import rejudgement_detail_view, rejudgement_view
from ..errors import ProblemCode, ServiceError
from ..views.decisions import RejudgementDetailView, RejudgementView
from .access import ChangingServicesOf, CompetitionOrganizerOf, ServicesOf
from .inputs import Input
from .problems import RESPONSES

router = APIRouter(prefix="/rejudgements", tags=["rejudging"], responses=RESPONSES)


class NewRejudgement(Input):
    """Which submissions are evaluated again, and why."""

    track: str = Field(max_length=100)
    competition: str | None = Field(
        default=None, max_length=100, description="Name of the competition; the one that opened last without it."
    )
    stage: str | None = Field(default=None, max_length=100, description="The one that opened last without it.")
    submissions: list[UUID] = Field(default=[], max_length=10_000, description="Empty: all models of the stage.")
    reason: str = Field(max_length=rejudging.REASON_LENGTH, description="In one line, for the audit log.")


class Application(Input):
    """What is applied."""

    shown: str | None = Field(
        default=None,
        max_length=64,
        description="`revision` of the rejudgement as it was looked at; a dry run needs none.",
    )


@router.get("")
def get_rejudgements(services: ServicesOf, principal: CompetitionOrganizerOf) -> list[RejudgementView]:
    """Return all rejudgements, newest first."""
    with services.database.transaction() as session:
        return [rejudgement_view(one) for one in rejudging.rejudgements(session, principal)]


@router.post("", status_code=HTTPStatus.CREATED)
def post_rejudgement(
    services: ChangingServicesOf, principal: CompetitionOrganizerOf, new: NewRejudgement
) -> RejudgementDetailView:
    """Evaluate submissions again with the present evaluator; nobody but organizers sees it, no result changes."""
    with services.database.transaction() as session:
        competition = Competition.find_by_track(session, new.track, new.competition or principal.competition)
        stage = competition.shown_stage(new.track, new.stage)
        made = rejudging.start(session, principal, stage, submissions=new.submissions, reason=new.reason)
        return rejudgement_detail_view(session, made)


@router.get("/{rejudgement_id}")
def get_rejudgement(
    services: ServicesOf, principal: CompetitionOrganizerOf, rejudgement_id: UUID
) -> RejudgementDetailView:
    """Return which scores and ranks would change."""
    with services.database.transaction() as session:
        return rejudgement_detail_view(session, rejudging.find(session, principal, rejudgement_id))


@router.post("/{rejudgement_id}/apply")
def apply_rejudgement(
    services: ChangingServicesOf, principal: CompetitionOrganizerOf, rejudgement_id: UUID, application: Application
) -> RejudgementDetailView:
    """Make the new results those of their submissions; refused if they are no longer those that were looked at."""
    if application.shown is None and not services.database.is_trial:
        raise ServiceError(ProblemCode.INVALID_REQUEST, "Give `shown`: the revision of what you looked at.")
    with services.database.transaction() as session:
        rows = rejudging.apply(session, principal, rejudgement_id, shown=application.shown)
        return rejudgement_detail_view(session, rejudging.find(session, principal, rejudgement_id), rows)


@router.post("/{rejudgement_id}/discard", status_code=HTTPStatus.NO_CONTENT, response_class=Response)
def discard_rejudgement(services: ChangingServicesOf, principal: CompetitionOrganizerOf, rejudgement_id: UUID) -> None:
    """Leave all present results as they are; what still waits or runs is cancelled."""
    with services.database.transaction() as session:
        rejudging.discard(session, principal, rejudgement_id)
