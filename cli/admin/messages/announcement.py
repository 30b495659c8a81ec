"""`vitac admin announcement`: what organizers say to everybody."""

from collections.abc import Sequence
from typing import Annotated

import typer
from sqlalchemy.orm import Session
from vitac.server.accounts import messages
from vitac.server.principals import CONSOLE
from vitac.server.views.messages import AnnouncementView

from ..verbs import change, list_records

app = typer.Typer(no_args_is_help=True, rich_markup_mode=None)


@change(app, unknown=("id",))
def publish(
    session: Session,
    title: Annotated[str, typer.Argument(help="One line.")],
    text: Annotated[str, typer.Argument(help="Plain text; an empty line begins a paragraph.")],
    notify: Annotated[bool, typer.Option("--notify", help="Send it to all teams, too.")] = False,
) -> AnnouncementView:
    """Show an announcement to everybody."""
    made = messages.publish_announcement(session, CONSOLE, title=title, text=text, notify=notify)
    return AnnouncementView.model_validate(made, from_attributes=True)


@list_records(app, "id", "published_at", "title", none="No announcement.")
def list_announcements(session: Session) -> Sequence[AnnouncementView]:
    """List the announcements that everybody sees."""
    return messages.list_announcements(session)


@change(app, done="announcement {announcement} is withdrawn")
def withdraw(
    session: Session,
    announcement: Annotated[int, typer.Argument(min=1, max=2_147_483_647, help="Number of the announcement.")],
) -> dict[str, object]:
    """Withdraw an announcement: nobody sees it any longer."""
    messages.withdraw_announcement(session, CONSOLE, announcement)
    return {"id": announcement, "withdrawn": True}
