"""The organizers' desk: what waits for them, each with the form that settles it, and the last lines of the audit log.

The forms call the routes that `vitac admin` calls.
"""

from collections.abc import Callable, Mapping

from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import Response
from vitac.server.api.appeals import put_ruling
from vitac.server.api.members import change_team
from vitac.server.api.messages import hide_question, post_announcement, put_answer, withdraw_announcement
from vitac.server.operations.desk import read_desk

from ..site import get_site, page, require_viewer
from .addresses import board_address
from .forms import submit

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
    route, fixed = CHANGES[name]
    return await submit(request, route, back=ADDRESS, fixed=fixed)


CHANGES: Mapping[str, tuple[Callable[..., object], Mapping[str, object]]] = {
    "accept": (change_team, {"accepted": True}),
    "refuse": (change_team, {"accepted": False}),
    "answer": (put_answer, {}),
    "hide": (hide_question, {}),
    "rule": (put_ruling, {}),
    "announce": (post_announcement, {}),
    "withdraw": (withdraw_announcement, {}),
}
"""What the forms of the page do, by the last part of their address."""
