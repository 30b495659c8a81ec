"""Announcements: what organizers say to everybody or to one team; shown on pages and sent to teams where wanted."""

from collections.abc import Collection
from datetime import timedelta
from uuid import UUID

from sqlalchemy import func, or_, select
from sqlalchemy.orm import Session

from .. import names
from ..audit import record
from ..competitions.competition import Competition
from ..database.clock import read_clock
from ..database.models import Announcement, Question, Submission, Team
from ..database.states import NoticeKind
from ..errors import ProblemCode, ServiceError, not_found
from ..names import clean_text
from ..principals import VISITOR, Principal
from ..views.correspondence import AnnouncementView, QuestionView
from . import teams
from .outbox import announce

TITLE_LENGTH = 120
ANNOUNCEMENTS_SHOWN = 100


def publish_announcement(
    session: Session,
    by: Principal,
    *,
    title: str,
    text: str,
    notify: bool,
    competition: str | None = None,
    team: Team | None = None,
) -> Announcement:
    """Show an announcement to everybody, or a message to one team.

    Args:
        session: of the transaction.
        by: an organizer.
        title: one line.
        text: plain text in paragraphs.
        notify: whether it is sent, too: to the team, else to all teams of which the competition has a submission, or
            to all of the service.
        competition: name of the one that it is about; None: the only one that the organizer has, or the service.
        team: the only one who sees it; None: everybody.

    Raises:
        ServiceError: not an organizer of it, there is no such competition, or title or text cannot be shown.
    """
    competition = competition or by.competition
    by.require_organizer(competition)
    made = Announcement(
        competition=Competition.find(session, competition).name if competition else "",
        team=team,
        title=names.clean(title, what="A title", min_length=2, max_length=TITLE_LENGTH),
        text=clean_text(text, what="An announcement"),
        published_at=read_clock(session),
    )
    session.add(made)
    session.flush()
    record(session, by, "announcement.publish", f"announcement:{made.id}", {"title": made.title, "notify": notify})
    if notify:
        facts = {"title": made.title, "text": made.text, "page": "/announcements"}
        for team_id in _find_receivers(session, made):
            announce(session, NoticeKind.ANNOUNCEMENT, team_id, f"announcement:{made.id}", facts)
    return made


def find_receiver(session: Session, by: Principal, team_id: UUID) -> Team:
    """Return a team to which an organizer may send a message.

    Raises:
        ServiceError: there is none, or it has no submission to the only competition of the organizer.
    """
    team, submissions = session.get(Team, team_id), select(Submission.id).where(Submission.team_id == team_id)
    submitted = submissions.where(Submission.competition == by.competition).limit(1)
    if team is None or not (by.organizes_service or session.scalar(submitted)):
        raise not_found("team", team_id)
    return team


def _find_receivers(session: Session, made: Announcement) -> Collection[UUID]:
    if made.team_id is not None:
        return [made.team_id]
    query = select(Team.id).where(Team.approved_at.is_not(None), Team.disqualified_at.is_(None))
    if made.competition:
        submitted = select(Submission.team_id).where(Submission.competition == made.competition)
        query = query.where(Team.id.in_(submitted))
    return session.scalars(query).all()


def withdraw_announcement(session: Session, by: Principal, announcement_id: int) -> None:
    """Show an announcement to nobody from now on; what was sent is sent. Doing it again changes nothing.

    Raises:
        ServiceError: not an organizer, or there is no such announcement.
    """
    by.require_organizer(by.competition)
    announcement = session.get(Announcement, announcement_id, with_for_update=True)
    if announcement is None:
        raise not_found("announcement", announcement_id)
    by.require_organizer(announcement.competition or None)
    if announcement.withdrawn_at is None:
        announcement.withdrawn_at = read_clock(session)
        after, before = {"shown": False}, {"shown": True, "title": announcement.title}
        record(session, by, "announcement.withdraw", f"announcement:{announcement.id}", after, before=before)


def list_announcements(
    session: Session, by: Principal = VISITOR, *, competition: str | None = None
) -> list[AnnouncementView]:
    """Return the announcements that somebody sees, newest first: those to everybody, and messages to the own team.

    Args:
        session: of the transaction.
        by: who reads; an organizer sees messages to all teams.
        competition: only what is of this one or of the whole service; None: of all.
    """
    query = select(Announcement).where(Announcement.withdrawn_at.is_(None)).order_by(Announcement.id.desc())
    if not by.organizes_any:
        query = query.where(or_(Announcement.team_id.is_(None), Announcement.team_id == by.team_id))
    elif by.competition is not None:
        query = query.where(or_(Announcement.team_id.is_(None), Announcement.competition == by.competition))
    if competition is not None:
        query = query.where(Announcement.competition.in_(("", competition)))
    return [make_announcement_view(one) for one in session.scalars(query.limit(ANNOUNCEMENTS_SHOWN))]


def make_announcement_view(announcement: Announcement) -> AnnouncementView:
    """Return an announcement as its readers see it."""
    return AnnouncementView.from_row(
        announcement,
        competition=announcement.competition or None,
        team=announcement.team.name if announcement.team is not None else None,
    )


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
    day = read_clock(session) - timedelta(days=1)
    of_team = select(func.count()).select_from(Question).where(Question.team_id == team.id)
    unanswered = session.scalar(of_team.where(Question.answered_at.is_(None), Question.hidden_at.is_(None))) or 0
    asked = session.scalar(of_team.where(Question.asked_at > day)) or 0
    if unanswered >= MAX_OPEN or asked >= MAX_A_DAY:
        raise ServiceError(
            ProblemCode.TOO_MANY_REQUESTS,
            f"A team may have {MAX_OPEN} questions without an answer and ask {MAX_A_DAY} in a day; {team.name} has "
            f"{unanswered} and has asked {asked}.",
        )
    made = Question(team_id=team.id, text=kept, public=public, asked_at=read_clock(session))
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
    question = _locked(session, question_id)
    before = {"answer": question.answer, "public": question.public}
    question.answer, question.public, question.answered_at = kept, public, read_clock(session)
    after = {"answer": kept, "public": public}
    record(session, by, "question.answer", f"question:{question.id}", after, before=before)
    return question


def hide_question(session: Session, by: Principal, question_id: int) -> None:
    """Show a question to nobody but its team and organizers, and expect no answer; doing it again changes nothing.

    Raises:
        ServiceError: not an organizer, or there is no such question.
    """
    by.require_organizer()
    question = _locked(session, question_id)
    if question.hidden_at is None:
        question.hidden_at = read_clock(session)
        after, before = {"hidden": True}, {"hidden": False}
        record(session, by, "question.hide", f"question:{question.id}", after, before=before)


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
    return QuestionView.from_row(
        question,
        team=question.team.name if knows_team and question.team is not None else None,
        hidden=question.hidden_at is not None,
    )


def _locked(session: Session, question_id: int) -> Question:
    question = session.get(Question, question_id, with_for_update=True)
    if question is None:
        raise not_found("question", question_id)
    return question
