"""Register a team: a form, and once the team's token."""

from __future__ import annotations

from http import HTTPStatus
from typing import TYPE_CHECKING

from vitac.server.errors import ProblemCode, ServiceError
from vitac.server.limiter import client_key

from ...session.forms import read_form
from ...site import page, site_of, viewer_of
from .sign_in import begin_session

if TYPE_CHECKING:
    from starlette.requests import Request
    from starlette.responses import Response

FIELDS = ("name", "contact", "invite")
IN_FORM = frozenset(
    {ProblemCode.INVALID_REQUEST, ProblemCode.INVITE_REQUIRED, ProblemCode.TEAM_EXISTS, ProblemCode.TOO_MANY_REQUESTS}
)
"""Refusals that are shown above the form, so that it can be corrected."""
NOTHING = dict.fromkeys(FIELDS, "")


async def register_form(request: Request) -> Response:
    """Show the form."""
    return await _page(request, viewer=await viewer_of(request), given=NOTHING)


async def register(request: Request) -> Response:
    """Register the team, show its token and begin a session."""
    fields = await read_form(request)
    given = {name: fields.get(name, "").strip() for name in FIELDS}
    address = client_key(request.client.host if request.client is not None else None)
    try:
        made = await site_of(request).data.register(**given, address=address)
    except ServiceError as error:
        if error.code not in IN_FORM:
            raise
        viewer = await viewer_of(request)
        return await _page(request, viewer=viewer, given=given, wrong=error.detail, status=error.status)
    answer = await _page(request, viewer=None, viewer_known=False, given=NOTHING, made=made, status=HTTPStatus.CREATED)
    answer.headers["Cache-Control"] = "no-store"
    begin_session(request, answer, made.token_id)
    return answer


async def _page(request: Request, **values: object) -> Response:
    shown = {"made": None, "wrong": None, "locked_since": await site_of(request).data.teams_locked_since(), **values}
    return page(request, "register.html", section="/register", **shown)  # type: ignore[arg-type]
