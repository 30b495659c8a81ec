"""Routes of judging and rejudging."""

from http import HTTPStatus
from typing import Annotated
from uuid import UUID

from fastapi import APIRouter, Query, Response
from pydantic import BaseModel, ConfigDict, Field
from sqlalchemy.orm import Session

from ..accounts.tokens import is_judge
from ..competitions.competition import Competition
from ..competitions.definition import Judging
from ..decisions import judging, rejudging
from ..decisions.rejudging import rejudgement_detail_view, rejudgement_view
from ..errors import ProblemCode, ServiceError
from ..principals import Principal
from ..views.decisions import JudgedTeamView, RejudgementDetailView, RejudgementView
from .access import ChangingServicesOf, CompetitionOrganizerOf, JudgeOf, ServicesOf
from .inputs import Input
from .problems import RESPONSES

router = APIRouter(tags=["judging"], responses=RESPONSES)


_ONE_LINE = r"^[^\x00-\x1f\x7f]+$"
JudgeName = Annotated[
    str | None, Field(default=None, max_length=100, pattern=_ONE_LINE, description="For organizers: who judges.")
]


class NewMarks(Input):
    """A judge's marks of a submission."""

    marks: dict[str, float] = Field(max_length=50, description="From 0 to 10, for every criterion of the track.")
    judge: JudgeName


class NewConflict(BaseModel):
    """A judge's conflict of interest with a team."""

    model_config = ConfigDict(extra="forbid", str_strip_whitespace=True)
    team: str = Field(max_length=100, pattern=_ONE_LINE, description="Name or id.")
    reason: str = Field(min_length=1, max_length=500, pattern=_ONE_LINE)
    judge: JudgeName


class NotedJudge(BaseModel):
    """Under whose name it was stored."""

    judge: str
    has_token: bool = Field(description="Whether a judge of that name has or had a token; a misspelt one has not.")


@router.put("/submissions/{submission_id}/marks")
def put_marks(services: ChangingServicesOf, principal: JudgeOf, submission_id: UUID, new: NewMarks) -> NotedJudge:
    """Store the marks of a judge by the track's rubric, replacing earlier ones (judges and organizers)."""
    with services.database.transaction() as session:
        judging.give_marks(session, principal, submission_id, new.marks, judge=new.judge)
        return _noted_judge(session, principal, new.judge)


@router.post("/judging/conflicts")
def post_conflict(services: ChangingServicesOf, principal: JudgeOf, new: NewConflict) -> NotedJudge:
    """Record a conflict of interest: removes the judge's marks of that team and accepts no new ones."""
    with services.database.transaction() as session:
        judging.declare_conflict(session, principal, new.team, new.reason, judge=new.judge)
        return _noted_judge(session, principal, new.judge)


@router.get("/competitions/{competition}/judging/{track}/rubric")
def get_rubric(services: ServicesOf, principal: JudgeOf, competition: str, track: str) -> Judging:  # noqa: ARG001
    """Show the criteria and weights of a track."""
    with services.database.reading() as session:
        return judging.find_rubric(Competition.find(session, competition), track)


@router.get("/judging/{track}")
def get_judged(
    services: ServicesOf,
    principal: CompetitionOrganizerOf,
    track: str,
    *,
    competition: Annotated[
        str | None, Query(description="Name of the competition; by default the one that opened last.")
    ] = None,
    stage: Annotated[str | None, Query(description="Name of the stage; by default the one that opened last.")] = None,
) -> list[JudgedTeamView]:
    """Return each team's marks with their spread, its figures and its total, best first (organizers only)."""
    with services.database.transaction() as session:
        wanted = Competition.find_by_track(session, track, competition or principal.competition).shown_stage(
            track, stage
        )
        return judging.judged(session, principal, wanted)


def _noted_judge(session: Session, principal: Principal, named: str | None) -> NotedJudge:
    judge = principal.judge_name or named or ""
    return NotedJudge(judge=judge, has_token=is_judge(session, judge))


rejudging_router = APIRouter(prefix="/rejudgements", tags=["rejudging"], responses=RESPONSES)


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


@rejudging_router.get("")
def get_rejudgements(services: ServicesOf, principal: CompetitionOrganizerOf) -> list[RejudgementView]:
    """Return all rejudgements, newest first."""
    with services.database.transaction() as session:
        return [rejudgement_view(one) for one in rejudging.rejudgements(session, principal)]


@rejudging_router.post("", status_code=HTTPStatus.CREATED)
def post_rejudgement(
    services: ChangingServicesOf, principal: CompetitionOrganizerOf, new: NewRejudgement
) -> RejudgementDetailView:
    """Evaluate submissions again with the present evaluator; nobody but organizers sees it, no result changes."""
    with services.database.transaction() as session:
        competition = Competition.find_by_track(session, new.track, new.competition or principal.competition)
        stage = competition.shown_stage(new.track, new.stage)
        made = rejudging.start(session, principal, stage, submissions=new.submissions, reason=new.reason)
        return rejudgement_detail_view(session, made)


@rejudging_router.get("/{rejudgement_id}")
def get_rejudgement(
    services: ServicesOf, principal: CompetitionOrganizerOf, rejudgement_id: UUID
) -> RejudgementDetailView:
    """Return which scores and ranks would change."""
    with services.database.transaction() as session:
        return rejudgement_detail_view(session, rejudging.find(session, principal, rejudgement_id))


@rejudging_router.post("/{rejudgement_id}/apply")
def apply_rejudgement(
    services: ChangingServicesOf, principal: CompetitionOrganizerOf, rejudgement_id: UUID, application: Application
) -> RejudgementDetailView:
    """Make the new results those of their submissions; refused if they are no longer those that were looked at."""
    if application.shown is None and not services.database.is_trial:
        raise ServiceError(ProblemCode.INVALID_REQUEST, "Give `shown`: the revision of what you looked at.")
    with services.database.transaction() as session:
        rows = rejudging.apply(session, principal, rejudgement_id, shown=application.shown)
        return rejudgement_detail_view(session, rejudging.find(session, principal, rejudgement_id), rows)


@rejudging_router.post("/{rejudgement_id}/discard", status_code=HTTPStatus.NO_CONTENT, response_class=Response)
def discard_rejudgement(services: ChangingServicesOf, principal: CompetitionOrganizerOf, rejudgement_id: UUID) -> None:
    """Leave all present results as they are; what still waits or runs is cancelled."""
    with services.database.transaction() as session:
        rejudging.discard(session, principal, rejudgement_id)
