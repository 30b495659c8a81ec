"""Routes of what people do by hand: briefs for a committee, results that operators enter, baselines."""

import asyncio
from collections.abc import AsyncIterator
from http import HTTPStatus
from typing import Annotated
from uuid import UUID

from fastapi import APIRouter, Request, Response
from pydantic import Field, FiniteFloat

from ..competitions.competition import Competition
from ..decisions import entered_results
from ..errors import ProblemCode, ServiceError
from ..leaderboards import baselines
from ..principals import Principal
from ..services import Services
from ..submissions import briefs
from ..views.by_hand import BriefListView, BriefView, EnteredBoardView
from ..views.leaderboards import BaselineView
from .access import (
    ChangingServicesOf,
    CompetitionOrganizerOf,
    JudgeOf,
    OrganizerOf,
    ServicesOf,
    SignedInOf,
    TeamOf,
    VisitorOf,
)
from .inputs import Input
from .problems import RESPONSES
from .teams import ONE_LINE

router = APIRouter(responses=RESPONSES)
HUMAN_BASELINE = "/tracks/{track}/tasks/{task}/human-baseline"
STAGE = "/competitions/{competition}/tracks/{track}/stages/{stage}"
OneLine = Annotated[str, Field(min_length=1, max_length=500, pattern=ONE_LINE)]


class BriefDecision(Input):
    """What the committee decides of a brief."""

    accepted: bool
    reason: OneLine


class PlayedByHand(Input):
    """An episode that a person played by marker flow alone."""

    shape: OneLine
    is_solved: bool
    env_steps: int = Field(ge=1, le=100_000)
    measures: dict[str, FiniteFloat] = Field(default={}, description="Of what boards may rank by, by its name.")


class NewHumanBaseline(Input):
    """All episodes of a task that people played by marker flow alone."""

    episodes: list[PlayedByHand] = Field(min_length=1, max_length=10_000)


class NewResult(Input):
    """The points of an attempt."""

    team: OneLine | None = Field(default=None, description="Name or id.")
    baseline: OneLine | None = Field(default=None, description="In place of a team: a policy of the organizers'.")
    attempt: int = Field(default=1, ge=1, le=1000, description="Of the team, from 1; entered again it is replaced.")
    points: dict[str, float] = Field(max_length=50, description="Of every task of the stage.")
    evidence: OneLine = Field(description="What shows it: the address of a film and its SHA-256, say.")


@router.put("/briefs/own", tags=["briefs"], openapi_extra={"requestBody": {"content": {"application/pdf": {}}}})
async def put_brief(
    services: ServicesOf, principal: TeamOf, request: Request, competition: str, track: str, stage: str
) -> BriefView:
    """Hand in the own team's brief for a stage, a PDF, in place of an earlier one."""
    return await receive_brief(services, principal, request.stream(), competition, track, stage)


async def receive_brief(
    services: Services, by: Principal, pieces: AsyncIterator[bytes], competition: str, track: str, stage: str
) -> BriefView:
    """Read a brief as it arrives, and hand it in.

    Raises:
        ServiceError: it is too large, or refused.
    """
    content = bytearray()
    async for piece in pieces:
        content += piece
        if len(content) > briefs.BRIEF_BYTES:
            raise ServiceError(
                ProblemCode.UPLOAD_TOO_LARGE, f"Expected a brief of at most {briefs.BRIEF_BYTES >> 20} MiB, got more."
            )

    def store() -> BriefView:
        with services.database.transaction() as session:
            its_stage = Competition.find(session, competition).stage(track, stage)
            return briefs.brief_view(briefs.hand_in(session, by, its_stage, bytes(content)))

    return await asyncio.to_thread(store)


@router.get(f"{STAGE}/briefs", tags=["briefs"])
def list_briefs(services: ServicesOf, principal: SignedInOf, competition: str, track: str, stage: str) -> BriefListView:
    """Return the own team's brief, all for organizers and judges."""
    with services.database.reading() as session:
        listed = briefs.list_briefs(session, principal, Competition.find(session, competition).stage(track, stage))
        return BriefListView(items=[briefs.brief_view(brief) for brief in listed])


@router.get(f"{STAGE}/briefs/{{team_id}}/document", tags=["briefs"], response_class=Response)
def get_brief(
    services: ServicesOf, principal: JudgeOf, competition: str, track: str, stage: str, team_id: UUID
) -> Response:
    """Return the PDF of a brief (judges and organizers)."""
    with services.database.reading() as session:
        brief = briefs.find(session, principal, Competition.find(session, competition).stage(track, stage), team_id)
        headers = {"Content-Disposition": f'attachment; filename="{brief.team_id}.pdf"', "Cache-Control": "no-store"}
        return Response(brief.content, status_code=HTTPStatus.OK, media_type="application/pdf", headers=headers)


@router.put(f"{STAGE}/briefs/{{team_id}}/decision", tags=["briefs"])
def put_decision(
    services: ChangingServicesOf,
    principal: JudgeOf,
    competition: str,
    track: str,
    stage: str,
    team_id: UUID,
    decision: BriefDecision,
) -> BriefView:
    """Decide whether a brief's team advances, once the stage has closed (judges and organizers)."""
    with services.database.transaction() as session:
        its_stage = Competition.find(session, competition).stage(track, stage)
        return briefs.brief_view(
            briefs.decide(session, principal, its_stage, team_id, decision.reason, accepted=decision.accepted)
        )


@router.put(f"{STAGE}/results", tags=["results"])
def put_result(
    services: ChangingServicesOf,
    principal: CompetitionOrganizerOf,
    competition: str,
    track: str,
    stage: str,
    new: NewResult,
) -> EnteredBoardView:
    """Enter the points of an attempt, in place of what was entered of it before; return the board."""
    with services.database.transaction() as session:
        its_stage = Competition.find(session, competition).stage(track, stage)
        entered_results.enter(session, principal, its_stage, **new.model_dump())
        return entered_results.board(session, its_stage, principal)


@router.get(f"{STAGE}/results", tags=["results"])
def get_results(
    services: ServicesOf, principal: VisitorOf, competition: str, track: str, stage: str
) -> EnteredBoardView:
    """Return the board of a stage whose results are entered: the best attempt of each team, the largest sum first."""
    with services.database.reading() as session:
        its_stage = Competition.find(session, competition).stage(track, stage)
        return entered_results.board(session, its_stage, principal)


@router.put(HUMAN_BASELINE, tags=["baselines"])
def put_human_baseline(
    services: ChangingServicesOf, principal: OrganizerOf, track: str, task: str, new: NewHumanBaseline
) -> BaselineView:
    """Show on boards what people solved of a task by marker flow alone, in place of what was shown before."""
    episodes = [(one.shape, one.is_solved, one.env_steps, one.measures) for one in new.episodes]
    with services.database.transaction() as session:
        return baselines.publish_human_baseline(session, principal, track, task, episodes)


@router.delete(HUMAN_BASELINE, tags=["baselines"], status_code=HTTPStatus.NO_CONTENT)
def delete_human_baseline(services: ChangingServicesOf, principal: OrganizerOf, track: str, task: str) -> None:
    """Show no longer what people solved of a task."""
    with services.database.transaction() as session:
        baselines.remove_human_baseline(session, principal, track, task)
