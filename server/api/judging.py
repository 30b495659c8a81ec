"""Routes of judging: marks and conflicts of interest by judges, and for organizers what follows from them."""

from http import HTTPStatus
from typing import Annotated
from uuid import UUID

from fastapi import APIRouter, Query, Response
from pydantic import BaseModel, ConfigDict, Field

from ..competition.competition import Competition
from ..judging import judging
from ..views.judging import JudgedTeamView
from .access import PrincipalOf, ServicesOf
from .problems import RESPONSES

router = APIRouter(tags=["judging"], responses=RESPONSES)

_ONE_LINE = r"^[^\x00-\x1f\x7f]+$"
JudgeName = Annotated[
    str | None, Field(default=None, max_length=100, pattern=_ONE_LINE, description="For organizers: who judges.")
]


class NewMarks(BaseModel):
    """A judge's marks of a submission."""

    model_config = ConfigDict(extra="forbid")
    marks: dict[str, float] = Field(max_length=50, description="From 0 to 10, for every criterion of the track.")
    judge: JudgeName


class NewConflict(BaseModel):
    """A judge's conflict of interest with a team."""

    model_config = ConfigDict(extra="forbid")
    team: str = Field(max_length=100, pattern=_ONE_LINE, description="Name or id.")
    reason: str = Field(min_length=1, max_length=500, pattern=_ONE_LINE)
    judge: JudgeName


@router.put("/submissions/{submission_id}/marks", status_code=HTTPStatus.NO_CONTENT, response_class=Response)
def put_marks(services: ServicesOf, principal: PrincipalOf, submission_id: UUID, new: NewMarks) -> None:
    """Give marks by the track's rubric, in place of those that the judge gave before (judges and organizers)."""
    with services.database.transaction() as session:
        judging.give_marks(session, principal, submission_id, new.marks, judge=new.judge)


@router.post("/judging/conflicts", status_code=HTTPStatus.NO_CONTENT, response_class=Response)
def post_conflict(services: ServicesOf, principal: PrincipalOf, new: NewConflict) -> None:
    """Declare a conflict of interest: marks for that team are removed, and no new ones are accepted."""
    with services.database.transaction() as session:
        judging.declare_conflict(session, principal, new.team, new.reason, judge=new.judge)


@router.get("/judging/{track}")
def get_judged(
    services: ServicesOf,
    principal: PrincipalOf,
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
