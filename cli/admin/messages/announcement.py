"""`vitac admin announcement`: what organizers say to everybody."""

from typing import Annotated

import typer

from ...service.database import transaction
from ...terminal.output import AsJson, print_done, print_record, print_records
from ..consent import DryRun, change_transaction

app = typer.Typer(no_args_is_help=True, rich_markup_mode=None)


@app.command()
def publish(
    title: Annotated[str, typer.Argument(help="One line.")],
    text: Annotated[str, typer.Argument(help="Plain text; an empty line begins a paragraph.")],
    notify: Annotated[bool, typer.Option("--notify", help="Send it to all teams, too.")] = False,
    dry_run: DryRun = False,
    as_json: AsJson = False,
) -> None:
    """Show an announcement to everybody."""
    from vitac.server.messages import announcements
    from vitac.server.principals import CONSOLE
    from vitac.server.views.messages import AnnouncementView

    with change_transaction(dry_run=dry_run) as session:
        made = announcements.publish(session, CONSOLE, title=title, text=text, notify=notify)
        shown = AnnouncementView.model_validate(made, from_attributes=True).model_dump()
    print_record(shown | ({"id": None} if dry_run else {}), as_json=as_json)


@app.command("list")
def list_announcements(as_json: AsJson = False) -> None:
    """List the announcements that everybody sees."""
    from vitac.server.messages.announcements import shown

    with transaction() as session:
        found = [one.model_dump() for one in shown(session)]
    print_records(found, ("id", "published_at", "title"), none="No announcement.", as_json=as_json)


@app.command()
def withdraw(
    announcement: Annotated[int, typer.Argument(min=1, max=2_147_483_647, help="Number of the announcement.")],
    dry_run: DryRun = False,
    as_json: AsJson = False,
) -> None:
    """Show an announcement to nobody from now on."""
    from vitac.server.messages.announcements import withdraw as withdraw_announcement
    from vitac.server.principals import CONSOLE

    with change_transaction(dry_run=dry_run) as session:
        withdraw_announcement(session, CONSOLE, announcement)
    content = {"id": announcement, "withdrawn": True}
    print_done(f"announcement {announcement} is withdrawn", content, as_json=as_json)
