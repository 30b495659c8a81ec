"""Routes of announcements and of questions to the organizers."""

from http import HTTPStatus
from typing import Annotated

from fastapi import APIRouter, Query, Response
from pydantic import Field

from ..accounts import messages
from ..names import TEXT_LENGTH
from ..principals import VISITOR
from ..views.correspondence import AnnouncementListView, AnnouncementView, QuestionListView, QuestionView
from .access import (
    ChangingServicesOf,
    CompetitionOrganizerOf,
    OptionalPrincipalOf,
    OrganizerOf,
    RowNumber,
    ServicesOf,
    TeamOf,
)
from .inputs import Input
from .problems import RESPONSES

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
