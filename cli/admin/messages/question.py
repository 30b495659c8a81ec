"""`vitac admin question`: questions of teams, and their answers."""

from typing import Annotated

import typer

from ...service.database import transaction
from ...terminal.output import AsJson, print_done, print_record, print_records
from ..consent import DryRun, change_transaction

app = typer.Typer(no_args_is_help=True, rich_markup_mode=None)

QuestionNumber = Annotated[int, typer.Argument(min=1, max=2_147_483_647, help="Number of the question.")]


@app.command("list")
def list_questions(
    open_only: Annotated[bool, typer.Option("--open", help="Only those without an answer.")] = False,
    as_json: AsJson = False,
) -> None:
    """List the questions of all teams, newest first."""
    from vitac.server.messages.questions import visible
    from vitac.server.principals import CONSOLE

    with transaction() as session:
        found = [one.model_dump() for one in visible(session, CONSOLE, open_only=open_only)]
    columns = ("id", "team", "asked_at", "public", "answered_at", "text")
    print_records(found, columns, none="No question.", as_json=as_json)


@app.command()
def answer(
    question: QuestionNumber,
    text: Annotated[str, typer.Argument(help="The answer, as plain text.")],
    public: Annotated[bool, typer.Option("--public/--private", help="Whether everybody sees both.")] = False,
    dry_run: DryRun = False,
    as_json: AsJson = False,
) -> None:
    """Answer a question, or replace its answer."""
    from vitac.server.messages.questions import answer as answer_question
    from vitac.server.messages.questions import question_view
    from vitac.server.principals import CONSOLE

    with change_transaction(dry_run=dry_run) as session:
        shown = question_view(answer_question(session, CONSOLE, question, text, public=public), CONSOLE).model_dump()
    print_record(shown, as_json=as_json)


@app.command()
def hide(question: QuestionNumber, dry_run: DryRun = False, as_json: AsJson = False) -> None:
    """Hide a question: only its team sees it, and it needs no answer."""
    from vitac.server.messages.questions import hide as hide_question
    from vitac.server.principals import CONSOLE

    with change_transaction(dry_run=dry_run) as session:
        hide_question(session, CONSOLE, question)
    print_done(f"question {question} is hidden", {"id": question, "hidden": True}, as_json=as_json)
