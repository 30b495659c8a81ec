"""`vitac admin question`: questions of teams, and their answers."""

from typing import Annotated

import typer
from sqlalchemy.orm import Session
from vitac.server.accounts import messages
from vitac.server.principals import CONSOLE
from vitac.server.views.messages import QuestionView

from ..verbs import change, list_records

app = typer.Typer(no_args_is_help=True, rich_markup_mode=None)

QuestionNumber = Annotated[int, typer.Argument(min=1, max=2_147_483_647, help="Number of the question.")]


@list_records(app, "id", "team", "asked_at", "public", "answered_at", "text", none="No question.")
def list_questions(
    session: Session,
    open_only: Annotated[bool, typer.Option("--open", help="Only questions without an answer.")] = False,
) -> list[QuestionView]:
    """List the questions of all teams, newest first."""
    return messages.list_questions(session, CONSOLE, open_only=open_only)


@change(app)
def answer(
    session: Session,
    question: QuestionNumber,
    text: Annotated[str, typer.Argument(help="The answer, as plain text.")],
    public: Annotated[bool, typer.Option("--public/--private", help="Let everybody see question and answer.")] = False,
) -> QuestionView:
    """Answer a question, or replace its answer."""
    return messages.make_question_view(
        messages.answer_question(session, CONSOLE, question, text, public=public), CONSOLE
    )


@change(app, done="question {question} is hidden")
def hide(session: Session, question: QuestionNumber) -> dict[str, object]:
    """Hide a question: only its team sees it, and it needs no answer."""
    messages.hide_question(session, CONSOLE, question)
    return {"id": question, "hidden": True}
