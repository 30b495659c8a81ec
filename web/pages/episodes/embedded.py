"""The player of a public episode alone, for frames of other sites: no session is known, and no cookie read."""

from functools import wraps
from http import HTTPStatus

from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import Response
from vitac.server.errors import ProblemCode, ServiceError

from ...headers import EMBEDDED
from ...site import Page, page
from .page import EMBED, EpisodePage, make_player, player_script, read_place

CLOSED = "There is no public episode here: its result is not published, or its list is sealed, or it was removed."


async def embedded(request: Request) -> Response:
    """Show an episode that everybody may see, or a sentence where there is none."""
    try:
        player: EpisodePage | None = await make_player(request, None, read_place(request), EMBED)
    except ServiceError as error:
        if error.code not in {ProblemCode.MISSING_CREDENTIALS, ProblemCode.NOT_FOUND}:
            raise
        player = None
    except HTTPException:  # no address of an episode
        player = None
    status = HTTPStatus.NOT_FOUND if player is None else HTTPStatus.OK
    answer = page(
        request,
        "embed.html",
        viewer=None,
        status=status,
        player=player,
        player_script=player_script(),
        closed=CLOSED,
    )
    answer.headers.update(EMBEDDED)
    return answer


def without_session(show: Page) -> Page:
    """Make a page one that answers everybody as a visitor, whatever cookies come with the request."""

    @wraps(show)
    async def shown(request: Request) -> Response:
        headers = [(name, value) for name, value in request.scope["headers"] if name != b"cookie"]
        return await show(Request(dict(request.scope) | {"headers": headers}, request.receive))

    return shown
