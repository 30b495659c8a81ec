"""The organizers' desk: what waits for them, each with the form that settles it, and the last lines of the audit log.

The forms call the same functions as `vitac admin`.
"""

from collections.abc import Callable, Mapping

from sqlalchemy.orm import Session
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import Response
from vitac.server.accounts import messages, teams
from vitac.server.appeals import appeals
from vitac.server.database.models import Team
from vitac.server.operations.desk import read_desk
from vitac.server.principals import Principal

from ..site import get_site, page, require_viewer
from .addresses import board_address
from .forms import act, read_id, read_number

Change = Callable[[Session, Principal, Mapping[str, str]], object]

ADDRESS = "/desk"


async def desk(request: Request) -> Response:
    """Show the desk to an organizer.

    Raises:
        ServiceError: the visitor is none.
    """
    viewer = await require_viewer(request)
    found = await get_site(request).ask(lambda session: read_desk(session, viewer.principal))
    return page(request, "desk.html", viewer=viewer, section=ADDRESS, found=found, board_address=board_address)


async def change(request: Request) -> Response:
    """Make one of the changes of the page's forms."""
    name = request.path_params["action"]
    if name not in CHANGES:
        raise HTTPException(404)
    return await act(request, CHANGES[name], back=ADDRESS)


def _team(session: Session, by: Principal, fields: Mapping[str, str]) -> Team:
    return teams.find_as_organizer(session, by, str(read_id(fields, "id")))


def _answer(session: Session, by: Principal, fields: Mapping[str, str]) -> object:
    return messages.answer_question(
        session, by, read_number(fields, "id"), fields.get("text", ""), public="public" in fields
    )


def _rule(session: Session, by: Principal, fields: Mapping[str, str]) -> object:
    upheld = fields.get("upheld") == "yes"
    return appeals.rule(session, by, read_number(fields, "id"), fields.get("text", ""), upheld=upheld)


def _announce(session: Session, by: Principal, fields: Mapping[str, str]) -> object:
    title, text = fields.get("title", ""), fields.get("text", "")
    return messages.publish_announcement(session, by, title=title, text=text, notify="notify" in fields)


CHANGES: Mapping[str, Change] = {
    "accept": lambda session, by, fields: teams.accept(session, by, _team(session, by, fields)),
    "refuse": lambda session, by, fields: teams.refuse(
        session, by, _team(session, by, fields), fields.get("reason", "")
    ),
    "answer": _answer,
    "hide": lambda session, by, fields: messages.hide_question(session, by, read_number(fields, "id")),
    "rule": _rule,
    "announce": _announce,
    "withdraw": lambda session, by, fields: messages.withdraw_announcement(session, by, read_number(fields, "id")),
}
"""What the forms of the page do, by the last part of their address."""
