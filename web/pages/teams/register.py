"""Register a team: a form, and once the team's token."""

import asyncio
from collections.abc import Mapping
from dataclasses import dataclass
from http import HTTPStatus
from uuid import UUID

from sqlalchemy.orm import Session
from starlette.requests import Request
from starlette.responses import Response
from vitac.server.accounts import registration, teams
from vitac.server.api.attempts import note_registration
from vitac.server.api.teams import NewTeam
from vitac.server.errors import ProblemCode, ServiceError

from ...session.forms import read_form
from ...site import get_site, get_viewer, page
from ..forms import checked_form
from .sign_in import begin_session

FIELDS = ("name", "contact", "invite")
IN_FORM = frozenset(
    {ProblemCode.INVALID_REQUEST, ProblemCode.INVITE_REQUIRED, ProblemCode.TEAM_EXISTS, ProblemCode.TOO_MANY_REQUESTS}
)
"""Refusals that are shown above the form, so that it can be corrected."""
NOTHING = dict.fromkeys(FIELDS, "")


@dataclass(frozen=True, kw_only=True)
class RegisteredTeam:
    """A team that has just registered, with its token, which is shown only now."""

    team: str
    token: str
    token_id: UUID
    waits_for_approval: bool


async def register_form(request: Request) -> Response:
    """Show the form."""
    return await _page(request, viewer=await get_viewer(request), given=NOTHING)


async def register(request: Request) -> Response:
    """Register the team, show its token and begin a session."""
    fields = await read_form(request)
    given = {name: fields.get(name, "").strip() for name in FIELDS}
    try:
        made = await _register(request, given)
    except ServiceError as error:
        if error.code not in IN_FORM:
            raise
        viewer = await get_viewer(request)
        return await _page(request, viewer=viewer, given=given, wrong=error.detail, status=error.status)
    answer = await _page(request, viewer=None, viewer_known=False, given=NOTHING, made=made, status=HTTPStatus.CREATED)
    answer.headers["Cache-Control"] = "no-store"
    begin_session(request, answer, made.token_id)
    return answer


async def _register(request: Request, given: Mapping[str, str]) -> RegisteredTeam:
    new = checked_form(NewTeam, {name: value if name == "name" else value or None for name, value in given.items()})
    await asyncio.to_thread(note_registration, request)
    site = get_site(request)

    def made(session: Session) -> RegisteredTeam:
        asked = registration.RegisteringTeam(**new.model_dump())
        team, issued = registration.register(session, site.services.settings, None, asked)
        return RegisteredTeam(
            team=team.name,
            token=issued.secret,
            token_id=issued.token.id,
            waits_for_approval=team.approved_at is None,
        )

    return await site.ask(made)


async def _page(request: Request, **values: object) -> Response:
    shown = {"made": None, "wrong": None, "locked_since": await get_site(request).ask(teams.find_lock_date), **values}
    return page(request, "register.html", section="/register", **shown)  # type: ignore[arg-type]
