"""Routes of appeals."""

from http import HTTPStatus
from uuid import UUID

from fastapi import APIRouter
from pydantic import Field

from ..names import TEXT_LENGTH
from ..submissions import appeals
from ..views.correspondence import AppealListView, AppealView
from .access import ChangingServicesOf, CompetitionOrganizerOf, OwnerOf, ReaderOf, RowNumber, ServicesOf, SignedInOf
from .inputs import Input
from .messages import OnlyOpen
from .problems import RESPONSES
from .teams import ONE_LINE

router = APIRouter(tags=["appeals"], responses=RESPONSES)


class NewAppeal(Input):
    """An appeal against the newest evaluation of a submission."""

    submission_id: UUID
    text: str = Field(min_length=2, max_length=TEXT_LENGTH, description="What went wrong, as plain text.")
    task: str | None = Field(default=None, max_length=100, pattern=ONE_LINE, description="In which task; null: in all.")
    episode: int | None = Field(default=None, ge=1, le=1_000_000, description="In which of its episodes.")


class Ruling(Input):
    """What the organizers decide."""

    upheld: bool
    text: str = Field(min_length=2, max_length=TEXT_LENGTH, description="Why, as plain text.")


@router.get("/competitions/{competition}/appeals")
@router.get("/appeals")
def list_appeals(
    services: ServicesOf, principal: SignedInOf, *, competition: str | None = None, open_only: OnlyOpen = False
) -> AppealListView:
    """Return the own team's appeals, all for organizers and judges, newest first."""
    with services.database.transaction() as session:
        return AppealListView(items=appeals.visible(session, principal, competition, open_only=open_only))


@router.post("/appeals", status_code=HTTPStatus.CREATED)
def post_appeal(services: ChangingServicesOf, principal: OwnerOf, new: NewAppeal) -> AppealView:
    """Appeal against the newest evaluation of an own submission."""
    with services.database.transaction() as session:
        made = appeals.open_appeal(session, principal, new.submission_id, new.text, task=new.task, episode=new.episode)
        return appeals.appeal_view(made, principal)


@router.get("/appeals/{appeal_id}")
def get_appeal(services: ServicesOf, principal: ReaderOf, appeal_id: RowNumber) -> AppealView:
    """Return an appeal with the episodes that were played again for it."""
    with services.database.transaction() as session:
        return appeals.appeal_view(appeals.find(session, principal, appeal_id), principal)


@router.post("/appeals/{appeal_id}/withdraw")
def withdraw_appeal(services: ChangingServicesOf, principal: OwnerOf, appeal_id: RowNumber) -> AppealView:
    """Withdraw an appeal of the own team."""
    with services.database.transaction() as session:
        appeals.withdraw(session, principal, appeal_id)
        return appeals.appeal_view(appeals.find(session, principal, appeal_id), principal)


@router.put("/appeals/{appeal_id}/ruling")
def put_ruling(
    services: ChangingServicesOf, principal: CompetitionOrganizerOf, appeal_id: RowNumber, ruling: Ruling
) -> AppealView:
    """Decide an appeal; for organizers. No result changes by it."""
    with services.database.transaction() as session:
        return appeals.appeal_view(
            appeals.rule(session, principal, appeal_id, ruling.text, upheld=ruling.upheld), principal
        )
