"""Routes of judging: marks and conflicts of interest by judges, and for organizers what follows from them."""

from typing import Annotated
from uuid import UUID

from fastapi import APIRouter, Query
from pydantic import BaseModel, ConfigDict, Field
from sqlalchemy.orm import Session

from ..accounts.tokens import is_judge
from ..competitions.competition import Competition
from ..competitions.definition import Judging
from ..decisions import judging
from ..principals import Principal
from ..views.decisions import JudgedTeamView
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
