"""Routes of correspondence: announcements, questions, appeals and their answers."""

from http import HTTPStatus
from typing import Annotated
from uuid import UUID

from fastapi import APIRouter, Query, Response
from pydantic import Field

from ..accounts import messages
from ..names import TEXT_LENGTH
from ..principals import VISITOR
from ..submissions import appeals
from ..views.correspondence import (
    AnnouncementListView,
    AnnouncementView,
    AppealListView,
    AppealView,
    QuestionListView,
    QuestionView,
)
from .access import (
    ChangingServicesOf,
    CompetitionOrganizerOf,
    OptionalPrincipalOf,
    OrganizerOf,
    OwnerOf,
    ReaderOf,
    RowNumber,
    ServicesOf,
    SignedInOf,
    TeamOf,
)
from .inputs import Input
from .problems import RESPONSES
from .teams import ONE_LINE

router = APIRouter(tags=["messages"], responses=RESPONSES)


class NewAnnouncement(Input):
    """What organizers say to everybody."""

    competition: str | None = Field(
        default=None,
        description="Which competition it is about; null: the one that the organizer has, or the whole service.",
    )
    title: str = Field(min_length=2, max_length=messages.TITLE_LENGTH)
    text: str = Field(min_length=2, max_length=TEXT_LENGTH, description="Plain text.")
    notify: bool = Field(
        default=False,
        description="Whether it is sent, too: to all teams with a submission to the competition, else to all teams.",
    )


class NewQuestion(Input):
    """A question to the organizers."""

    text: str = Field(min_length=2, max_length=TEXT_LENGTH, description="Plain text.")
    public: bool = Field(description="Whether everybody may see it, without the team's name, once it is answered.")


class QuestionAnswer(Input):
    """An answer of the organizers."""

    text: str = Field(min_length=2, max_length=TEXT_LENGTH, description="Plain text.")
    public: bool = Field(description="Whether everybody sees question and answer.")


OfCompetition = Annotated[
    str | None, Query(description="Only announcements of this competition and of the whole service.")
]
OnlyOpen = Annotated[bool, Query(alias="open", description="Only those that nobody has answered or decided.")]


@router.get("/announcements")
def list_announcements(
    services: ServicesOf, principal: OptionalPrincipalOf, competition: OfCompetition = None
) -> AnnouncementListView:
    """Return what the organizers say to everybody, and messages to the own team, newest first."""
    with services.database.transaction() as session:
        by = principal or VISITOR
        return AnnouncementListView(items=messages.list_announcements(session, by, competition=competition))


@router.post("/announcements", status_code=HTTPStatus.CREATED)
def post_announcement(
    services: ChangingServicesOf, principal: CompetitionOrganizerOf, new: NewAnnouncement
) -> AnnouncementView:
    """Say something to everybody, about the whole service or a competition; for organizers of it."""
    with services.database.transaction() as session:
        made = messages.publish_announcement(session, principal, **new.model_dump())
        return messages.make_announcement_view(made)


@router.delete("/announcements/{announcement_id}", status_code=HTTPStatus.NO_CONTENT, response_class=Response)
def withdraw_announcement(
    services: ChangingServicesOf, principal: CompetitionOrganizerOf, announcement_id: RowNumber
) -> None:
    """Show an announcement to nobody from now on; for organizers of what it is about."""
    with services.database.transaction() as session:
        messages.withdraw_announcement(session, principal, announcement_id)


@router.get("/questions")
def list_questions(
    services: ServicesOf, principal: OptionalPrincipalOf, *, open_only: OnlyOpen = False
) -> QuestionListView:
    """Return public questions with their answers, and those of the own team (all for an organizer), newest first."""
    with services.database.transaction() as session:
        return QuestionListView(items=messages.list_questions(session, principal, open_only=open_only))


@router.post("/questions", status_code=HTTPStatus.CREATED)
def post_question(services: ChangingServicesOf, principal: TeamOf, new: NewQuestion) -> QuestionView:
    """Ask the organizers; for teams."""
    with services.database.transaction() as session:
        return messages.make_question_view(
            messages.ask_question(session, principal, new.text, public=new.public), principal
        )


@router.put("/questions/{question_id}/answer")
def put_answer(
    services: ChangingServicesOf, principal: OrganizerOf, question_id: RowNumber, answer: QuestionAnswer
) -> QuestionView:
    """Answer a question, or replace its answer; for organizers."""
    with services.database.transaction() as session:
        question = messages.answer_question(session, principal, question_id, answer.text, public=answer.public)
        return messages.make_question_view(question, principal)


@router.delete("/questions/{question_id}", status_code=HTTPStatus.NO_CONTENT, response_class=Response)
def hide_question(services: ChangingServicesOf, principal: OrganizerOf, question_id: RowNumber) -> None:
    """Hide a question: only its team sees it, and it needs no answer; for organizers."""
    with services.database.transaction() as session:
        messages.hide_question(session, principal, question_id)


appeals_router = APIRouter(tags=["appeals"], responses=RESPONSES)


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


@appeals_router.get("/competitions/{competition}/appeals")
@appeals_router.get("/appeals")
def list_appeals(
    services: ServicesOf, principal: SignedInOf, *, competition: str | None = None, open_only: OnlyOpen = False
) -> AppealListView:
    """Return the own team's appeals, all for organizers and judges, newest first."""
    with services.database.transaction() as session:
        return AppealListView(items=appeals.visible(session, principal, competition, open_only=open_only))


@appeals_router.post("/appeals", status_code=HTTPStatus.CREATED)
def post_appeal(services: ChangingServicesOf, principal: OwnerOf, new: NewAppeal) -> AppealView:
    """Appeal against the newest evaluation of an own submission."""
    with services.database.transaction() as session:
        made = appeals.open_appeal(session, principal, new.submission_id, new.text, task=new.task, episode=new.episode)
        return appeals.appeal_view(made, principal)


@appeals_router.get("/appeals/{appeal_id}")
def get_appeal(services: ServicesOf, principal: ReaderOf, appeal_id: RowNumber) -> AppealView:
    """Return an appeal with the episodes that were played again for it."""
    with services.database.transaction() as session:
        return appeals.appeal_view(appeals.find(session, principal, appeal_id), principal)


@appeals_router.post("/appeals/{appeal_id}/withdraw")
def withdraw_appeal(services: ChangingServicesOf, principal: OwnerOf, appeal_id: RowNumber) -> AppealView:
    """Withdraw an appeal of the own team."""
    with services.database.transaction() as session:
        appeals.withdraw(session, principal, appeal_id)
        return appeals.appeal_view(appeals.find(session, principal, appeal_id), principal)


@appeals_router.put("/appeals/{appeal_id}/ruling")
def put_ruling(
    services: ChangingServicesOf, principal: CompetitionOrganizerOf, appeal_id: RowNumber, ruling: Ruling
) -> AppealView:
    """Decide an appeal; for organizers. No result changes by it."""
    with services.database.transaction() as session:
        return appeals.appeal_view(
            appeals.rule(session, principal, appeal_id, ruling.text, upheld=ruling.upheld), principal
        )
