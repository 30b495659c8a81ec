"""Announcements: what organizers say to everybody; shown on the competition's page and sent to teams where wanted."""

from datetime import UTC, datetime, timedelta

from sqlalchemy import func, or_, select
from sqlalchemy.orm import Session

from .. import names
from ..audit import record
from ..database.models import Announcement, Question, Team
from ..database.states import NoticeKind
from ..errors import ProblemCode, ServiceError, not_found
from ..names import clean_text
from ..principals import Principal
from ..views.correspondence import AnnouncementView, QuestionView
from . import teams
from .outbox import announce

TITLE_LENGTH = 120
ANNOUNCEMENTS_SHOWN = 100


def publish_announcement(session: Session, by: Principal, *, title: str, text: str, notify: bool) -> Announcement:
    """Show an announcement to everybody.

    Args:
        session: of the transaction.
        by: an organizer.
        title: one line.
        text: plain text in paragraphs.
        notify: whether it is sent to all teams, too.

    Raises:
        ServiceError: not an organizer, or title or text cannot be shown.
    """
    by.require_organizer()
    made = Announcement(
        title=names.clean(title, what="A title", min_length=2, max_length=TITLE_LENGTH),
        text=clean_text(text, what="An announcement"),
        published_at=datetime.now(UTC),
    )
    session.add(made)
    session.flush()
    record(session, by, "announcement.publish", f"announcement:{made.id}", {"title": made.title, "notify": notify})
    if notify:
        facts = {"title": made.title, "text": made.text, "page": "/announcements"}
        taking_part = Team.approved_at.is_not(None), Team.disqualified_at.is_(None)
        for team_id in session.scalars(select(Team.id).where(*taking_part)).all():
            announce(session, NoticeKind.ANNOUNCEMENT, team_id, f"announcement:{made.id}", facts)
    return made


def withdraw_announcement(session: Session, by: Principal, announcement_id: int) -> None:
    """Show an announcement to nobody from now on; what was sent is sent. Doing it again changes nothing.

    Raises:
        ServiceError: not an organizer, or there is no such announcement.
    """
    by.require_organizer()
    found = session.get(Announcement, announcement_id, with_for_update=True)
    if found is None:
        raise not_found("announcement", announcement_id)
    if found.withdrawn_at is None:
        found.withdrawn_at = datetime.now(UTC)
        after, before = {"shown": False}, {"shown": True, "title": found.title}
        record(session, by, "announcement.withdraw", f"announcement:{found.id}", after, before=before)


def list_announcements(session: Session) -> list[AnnouncementView]:
    """Return the announcements that everybody sees, newest first."""
    query = select(Announcement).where(Announcement.withdrawn_at.is_(None)).order_by(Announcement.id.desc())
    return [
        AnnouncementView.model_validate(one, from_attributes=True)
        for one in session.scalars(query.limit(ANNOUNCEMENTS_SHOWN))
    ]


MAX_OPEN = 5
MAX_A_DAY = 20
QUESTIONS_SHOWN = 200


def ask_question(session: Session, by: Principal, text: str, *, public: bool) -> Question:
    """Ask the organizers; a public question is shown to everybody, without the team's name, once it is answered.

    Raises:
        ServiceError: not a team, the text cannot be shown, or the team has asked too much.
    """
    team = teams.own(session, by)
    kept = clean_text(text, what="A question")
    teams.lock(session, team)
    day = datetime.now(UTC) - timedelta(days=1)
    of_team = select(func.count()).select_from(Question).where(Question.team_id == team.id)
    unanswered = session.scalar(of_team.where(Question.answered_at.is_(None), Question.hidden_at.is_(None))) or 0
    asked = session.scalar(of_team.where(Question.asked_at > day)) or 0
    if unanswered >= MAX_OPEN or asked >= MAX_A_DAY:
        raise ServiceError(
            ProblemCode.TOO_MANY_REQUESTS,
            f"A team may have {MAX_OPEN} questions without an answer and ask {MAX_A_DAY} in a day; {team.name} has "
            f"{unanswered} and has asked {asked}.",
        )
    made = Question(team_id=team.id, text=kept, public=public, asked_at=datetime.now(UTC))
    session.add(made)
    session.flush()
    record(session, by, "question.ask", f"question:{made.id}", {"public": public})
    return made


def answer_question(session: Session, by: Principal, question_id: int, text: str, *, public: bool) -> Question:
    """Answer a question, or replace its answer; whether everybody sees both is the organizers' decision.

    Raises:
        ServiceError: not an organizer, there is no such question, or the text cannot be shown.
    """
    by.require_organizer()
    kept = clean_text(text, what="An answer")
    found = _locked(session, question_id)
    before = {"answer": found.answer, "public": found.public}
    found.answer, found.public, found.answered_at = kept, public, datetime.now(UTC)
    after = {"answer": kept, "public": public}
    record(session, by, "question.answer", f"question:{found.id}", after, before=before)
    return found


def hide_question(session: Session, by: Principal, question_id: int) -> None:
    """Show a question to nobody but its team and organizers, and expect no answer; doing it again changes nothing.

    Raises:
        ServiceError: not an organizer, or there is no such question.
    """
    by.require_organizer()
    found = _locked(session, question_id)
    if found.hidden_at is None:
        found.hidden_at = datetime.now(UTC)
        after, before = {"hidden": True}, {"hidden": False}
        record(session, by, "question.hide", f"question:{found.id}", after, before=before)


def list_questions(session: Session, by: Principal | None, *, open_only: bool = False) -> list[QuestionView]:
    """Return the questions that somebody may see, newest first: answered public ones, own ones, an organizer's all."""
    query = select(Question).order_by(Question.id.desc()).limit(QUESTIONS_SHOWN)
    if by is None or not by.organizes_service:
        is_public = Question.public & Question.answered_at.is_not(None) & Question.hidden_at.is_(None)
        query = query.where(or_(is_public, Question.team_id == by.team_id) if by and by.team_id else is_public)
    if open_only:
        query = query.where(Question.answered_at.is_(None), Question.hidden_at.is_(None))
    return [make_question_view(one, by) for one in session.scalars(query)]


def make_question_view(question: Question, by: Principal | None) -> QuestionView:
    """Return a question as somebody who may see it does."""
    knows_team = by is not None and (by.organizes_service or by.team_id == question.team_id)
    return QuestionView(
        id=question.id,
        team=question.team.name if knows_team and question.team is not None else None,
        text=question.text,
        public=question.public,
        asked_at=question.asked_at,
        answer=question.answer,
        answered_at=question.answered_at,
        hidden=question.hidden_at is not None,
    )


def _locked(session: Session, question_id: int) -> Question:
    found = session.get(Question, question_id, with_for_update=True)
    if found is None:
        raise not_found("question", question_id)
    return found
