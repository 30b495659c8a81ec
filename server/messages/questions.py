"""Questions of teams to the organizers, and their answers: for the team alone, or for everybody."""

from datetime import UTC, datetime, timedelta

from sqlalchemy import func, or_, select
from sqlalchemy.orm import Session

from ..audit import record
from ..db.models import Question
from ..errors import ProblemCode, ServiceError, not_found
from ..principals import Principal
from ..teams import teams
from ..texts import clean_text
from ..views.messages import QuestionView

MAX_OPEN = 5
MAX_A_DAY = 20
SHOWN = 200


def ask(session: Session, by: Principal, text: str, *, public: bool) -> Question:
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


def answer(session: Session, by: Principal, question_id: int, text: str, *, public: bool) -> Question:
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


def hide(session: Session, by: Principal, question_id: int) -> None:
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


def visible(session: Session, by: Principal | None, *, open_only: bool = False) -> list[QuestionView]:
    """Return the questions that somebody may see, newest first: answered public ones, own ones, an organizer's all."""
    query = select(Question).order_by(Question.id.desc()).limit(SHOWN)
    if by is None or not by.is_organizer:
        is_public = Question.public & Question.answered_at.is_not(None) & Question.hidden_at.is_(None)
        query = query.where(or_(is_public, Question.team_id == by.team_id) if by and by.team_id else is_public)
    if open_only:
        query = query.where(Question.answered_at.is_(None), Question.hidden_at.is_(None))
    return [question_view(one, by) for one in session.scalars(query)]


def question_view(question: Question, by: Principal | None) -> QuestionView:
    """Return a question as somebody who may see it does."""
    knows_team = by is not None and (by.is_organizer or by.team_id == question.team_id)
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
