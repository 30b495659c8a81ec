"""`vitac admin notice`: what goes to teams by e-mail and webhook."""

from typing import Annotated
from uuid import UUID

import typer
from sqlalchemy.orm import Session
from vitac.server.accounts import outbox
from vitac.server.principals import CONSOLE
from vitac.server.views.notices import NoticeView

from .verbs import change, list_records

app = typer.Typer(no_args_is_help=True, rich_markup_mode=None)


@list_records(
    app,
    *("created_at", "kind", "channel", "target", "attempts", "sent_at", "given_up_at", "problem", "id"),
    none="No notice.",
)
def list_notices(
    session: Session,
    unsent: Annotated[bool, typer.Option("--unsent", help="Only notices that wait or were given up.")] = False,
    limit: Annotated[int, typer.Option(min=1, max=10_000, help="Maximum number of rows.")] = 50,
) -> list[NoticeView]:
    """List notices, newest first."""
    return [outbox.notice_view(notice) for notice in outbox.newest(session, limit, unsent_only=unsent)]


@change(app)
def retry(session: Session, notice: Annotated[UUID, typer.Argument(help="Id of the notice.")]) -> NoticeView:
    """Send a notice again that was given up."""
    return outbox.notice_view(outbox.retry(session, CONSOLE, notice))
