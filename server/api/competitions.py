"""Routes of competitions: what everybody may read, and the freezing and the end for their organizers."""

from http import HTTPStatus

from fastapi import APIRouter, Response
from pydantic import BaseModel, ConfigDict, Field

from ..advancement import advancement
from ..competition import freezing
from ..competition.competition import Competition
from ..competition.view import competition_list_view, competition_view
from ..prizes import finishing
from ..publishing.archive import archive_view
from ..teams.teams import REASON_LENGTH
from ..views.competition import AdvancementView, ArchiveView, CompetitionListView, CompetitionView
from .access import PrincipalOf, ServicesOf
from .problems import RESPONSES

router = APIRouter(tags=["competitions"], responses=RESPONSES)


class Decision(BaseModel):
    """Who takes part in a stage besides or without those that its rule takes."""

    model_config = ConfigDict(extra="forbid")
    add: list[str] = Field(default=[], max_length=1000, description="Names or ids of further teams.")
    without: list[str] = Field(default=[], max_length=1000, description="Proposed teams that do not take part.")
    revision: str = Field(
        default="",
        max_length=64,
        description="Of the confirmed teams as you saw them; empty if there were none.",
    )


class FinalEnd(BaseModel):
    """How a competition is ended."""

    model_config = ConfigDict(extra="forbid")
    confirm: list[str] = Field(
        default=[], max_length=100, description="Names of what is not settled and is meant; a refusal lists them."
    )
    again: bool = Field(
        default=False, description="Decide the winners of a final competition again, without disqualified teams."
    )


class Reopening(BaseModel):
    """Why a final competition is reopened."""

    model_config = ConfigDict(extra="forbid")
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
    services: ServicesOf, principal: PrincipalOf, competition: str, track: str, stage: str
) -> AdvancementView:
    """Return who would advance to a stage by its rule, and who was confirmed."""
    with services.database.transaction() as session:
        return advancement.propose(
            session, principal, Competition.find(session, competition, track=track).stage(track, stage)
        )


@router.put("/competitions/{competition}/tracks/{track}/stages/{stage}/advancement")
def confirm_advancement(
    services: ServicesOf, principal: PrincipalOf, competition: str, track: str, stage: str, decision: Decision
) -> AdvancementView:
    """Let the proposed teams, more of them or fewer, take part in a stage."""
    with services.database.transaction() as session:
        found = Competition.find(session, competition, track=track).stage(track, stage)
        advancement.confirm(
            session, principal, found, add=decision.add, without=decision.without, base=decision.revision
        )
        return advancement.propose(session, principal, found)


@router.post("/competitions/{competition}/freeze", status_code=HTTPStatus.NO_CONTENT, response_class=Response)
def freeze(services: ServicesOf, principal: PrincipalOf, competition: str) -> None:
    """Freeze the boards of a competition for everybody but its organizers."""
    with services.database.transaction() as session:
        freezing.freeze(session, principal, competition)


@router.post("/competitions/{competition}/unfreeze", status_code=HTTPStatus.NO_CONTENT, response_class=Response)
def unfreeze(services: ServicesOf, principal: PrincipalOf, competition: str) -> None:
    """Show all results on the boards of a competition again."""
    with services.database.transaction() as session:
        freezing.unfreeze(session, principal, competition)


@router.post("/competitions/{competition}/finalize")
def finalize(services: ServicesOf, principal: PrincipalOf, competition: str, end: FinalEnd) -> CompetitionView:
    """End a competition with the winners as they are now, or decide the winners of a final one again."""
    with services.database.transaction() as session:
        if end.again:
            finishing.finalize_again(session, principal, competition)
        else:
            finishing.finalize(session, principal, competition, confirmed=end.confirm)
        return competition_view(session, competition)


@router.post("/competitions/{competition}/reopen")
def reopen(services: ServicesOf, principal: PrincipalOf, competition: str, reopening: Reopening) -> CompetitionView:
    """Reopen a final competition; everybody reads the reason."""
    with services.database.transaction() as session:
        finishing.reopen(session, principal, reopening.reason, competition)
        return competition_view(session, competition)
