"""The team's page: members, invitations, tokens and sessions, each with its forms; and the page that joins a team."""

import asyncio
from collections.abc import Callable, Mapping
from datetime import datetime, timedelta
from http import HTTPStatus
from types import MappingProxyType
from uuid import UUID

from sqlalchemy.orm import Session
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import RedirectResponse, Response
from vitac.server.accounts import members, passwords, teams, tokens
from vitac.server.api.access import note_password, note_registration
from vitac.server.api.members import MemberChanges, NewMember
from vitac.server.api.middleware.shares import leave_place
from vitac.server.database.models import Member
from vitac.server.database.states import MemberRole, NoticeKind
from vitac.server.errors import ServiceError
from vitac.server.operations import team_data
from vitac.server.principals import Principal
from vitac.server.views.teams import OwnTeamView, TokenView

from ...session.signer import read_form
from ...site import get_site, get_viewer, page, require_viewer, signed_in_form
from ..forms import act, checked_form, read_id
from .sign_in import begin_session

Change = Callable[[Session, Principal, Mapping[str, str]], object]

ADDRESS = "/team"
NOTICES: Mapping[NoticeKind, str] = MappingProxyType(
    {
        NoticeKind.ACCEPTED: "A submission waits for its evaluation",
        NoticeKind.FINISHED: "An evaluation has a score",
        NoticeKind.FAILED: "An evaluation has ended without one",
        NoticeKind.PROMOTED: "The team takes part in a further stage",
        NoticeKind.DEADLINE: "A stage closes within 24 hours",
        NoticeKind.ANNOUNCEMENT: "The organizers announce something to all teams",
    }
)
"""What each kind of notice says, in the form of a member."""


async def team(request: Request) -> Response:
    """Show the team of a signed-in member.

    Raises:
        ServiceError: an organizer or judge belongs to none.
    """
    viewer = await require_viewer(request)
    by = viewer.principal

    def read(session: Session) -> tuple[OwnTeamView, list[TokenView], datetime | None]:
        good = [tokens.token_view(found) for found in tokens.list_tokens(session, by) if found.revoked_at is None]
        return members.own_team_view(session, by, teams.own(session, by)), good, teams.find_lock_date(session)

    found, good, locked_since = await get_site(request).ask(read)
    myself = next(
        (one for one in found.members if one.id == by.member_id or (by.leads_team and one.role is MemberRole.CAPTAIN)),
        None,
    )
    return page(
        request,
        "teams/team.html",
        viewer=viewer,
        section=ADDRESS,
        found=found,
        good=good,
        myself=myself,
        leads=by.leads_team,
        notices=NOTICES,
        locked_since=locked_since,
    )


async def data(request: Request) -> Response:
    """Download all data that the service stores about the team."""
    viewer = await require_viewer(request)
    by, settings = viewer.principal, get_site(request).services.settings
    found = await get_site(request).ask(lambda session: team_data.export(session, settings, by, teams.own(session, by)))
    headers = {"Cache-Control": "no-store", "Content-Disposition": 'attachment; filename="team.json"'}
    return Response(found.model_dump_json(indent=1), media_type="application/json", headers=headers)


async def change(request: Request) -> Response:
    """Make one of the changes of the page's forms."""
    name = request.path_params["action"]
    if name not in CHANGES:
        raise HTTPException(404)
    return await act(request, CHANGES[name], back=ADDRESS)


async def change_password(request: Request) -> Response:
    """Set the password of the member who asks, or take it away."""
    viewer, fields = await signed_in_form(request)
    by, site = viewer.principal, get_site(request)
    given = {name: fields.get(name) or None for name in ("password", "old_password")}
    changes = checked_form(MemberChanges, given)
    member = await site.read(lambda session: _self(session, by))
    await asyncio.to_thread(note_password, request, str(member.team_id), str(member.id), device="token")
    leave_place(request)
    await passwords.KNOWN_DEVICES.wait_for(
        members.set_password,
        site.services.database,
        by,
        member.team_id,
        member.id,
        changes.password,
        old=changes.old_password,
    )
    return RedirectResponse(ADDRESS, status_code=303)


async def invite(request: Request) -> Response:
    """Make an invitation and show its code once."""
    viewer, _ = await signed_in_form(request)
    by = viewer.principal
    code = await get_site(request).ask(lambda session: members.invite(session, by, teams.own(session, by))[1])
    return page(
        request, "teams/secret.html", viewer=viewer, section=ADDRESS, status=201, what="invitation", secret=code
    )


async def renew_token(request: Request) -> Response:
    """Make a new token for the member who asks and show it once; the browser stays signed in."""
    viewer, _ = await signed_in_form(request)
    by, lifetime = viewer.principal, _token_lifetime(request)

    def made(session: Session) -> tuple[str, UUID]:
        issued = members.renew_token(session, by, _self(session, by), lifetime)
        return issued.secret, issued.token.id

    secret, token_id = await get_site(request).ask(made)
    shown = {"viewer_known": False, "what": "token", "secret": secret}  # the earlier session has ended
    answer = page(request, "teams/secret.html", viewer=None, section=ADDRESS, status=HTTPStatus.CREATED, **shown)
    answer.headers["Cache-Control"] = "no-store"
    begin_session(request, answer, token_id, expires_at=viewer.expires_at)
    return answer


async def join_form(request: Request) -> Response:
    """Show the form with which somebody joins a team."""
    return await _join_page(request, viewer=await get_viewer(request))


async def join(request: Request) -> Response:
    """Make somebody with an invitation a member, show their token and begin a session."""
    fields = await read_form(request)
    given = {name: fields.get(name, "").strip() for name in ("code", "name", "email")}
    lifetime = _token_lifetime(request)

    try:
        filled = {**given, "password": fields.get("password", "")}
        checked = checked_form(NewMember, {name: value or None for name, value in filled.items()})
        await asyncio.to_thread(note_registration, request)
        thread, password = passwords.UNKNOWN_DEVICES, checked.password
        leave_place(request)
        password_hash = password and await thread.wait_for(passwords.hashed, password)
        joining = members.JoiningMember(**checked.model_dump(exclude={"password"}), password_hash=password_hash)

        def joined(session: Session) -> tuple[str, str, UUID]:
            member, issued = members.join(session, joining, lifetime)
            return member.team.name, issued.secret, issued.token.id

        team_name, secret, token_id = await get_site(request).ask(joined)
    except ServiceError as error:
        viewer = await get_viewer(request)
        return await _join_page(request, viewer=viewer, wrong=error.detail, given=given, status=error.status)
    made = {"made": (team_name, secret), "viewer_known": False}
    answer = await _join_page(request, viewer=None, status=HTTPStatus.CREATED, **made)
    answer.headers["Cache-Control"] = "no-store"
    begin_session(request, answer, token_id)
    return answer


def _self(session: Session, by: Principal) -> Member:
    """Return the member who asks; who has the shared token of a captain without one of their own is the captain."""
    own = teams.own(session, by)
    return members.find(session, by, own.id, by.member_id or members.find_captain(session, own).id)


def _change_self(session: Session, by: Principal, fields: Mapping[str, str]) -> None:
    email = checked_form(MemberChanges, {"email": fields.get("email", "").strip() or None}).email
    members.set_email(session, by, _self(session, by), email)


def _confirm_email(session: Session, by: Principal, fields: Mapping[str, str]) -> None:
    code = checked_form(MemberChanges, {"email_code": fields.get("code", "")}).email_code or ""
    members.confirm_email(session, by, _self(session, by), code)


def _choose_notices(session: Session, by: Principal, fields: Mapping[str, str]) -> None:
    """Mute the kinds whose box is not ticked; browsers leave those out."""
    members.mute(session, by, _self(session, by), [kind for kind in NOTICES if kind.value not in fields])


def _member(session: Session, by: Principal, fields: Mapping[str, str]) -> Member:
    return members.find(session, by, teams.own(session, by).id, read_id(fields, "id"))


CHANGES: Mapping[str, Change] = {
    "me": _change_self,
    "email": _confirm_email,
    "notices": _choose_notices,
    "leave": lambda session, by, _: members.remove(session, by, _self(session, by)),
    "remove": lambda session, by, fields: members.remove(session, by, _member(session, by, fields)),
    "captain": lambda session, by, fields: members.hand_over(session, by, _member(session, by, fields)),
    "withdraw": lambda session, by, fields: members.withdraw_invitation(
        session, by, teams.own(session, by), read_id(fields, "id")
    ),
    "revoke": lambda session, by, fields: tokens.revoke(session, by, read_id(fields, "id")),
}
"""What the forms of the page do, by the last part of their address."""


def _token_lifetime(request: Request) -> timedelta:
    return timedelta(days=get_site(request).services.settings.token_lifetime_days)


async def _join_page(request: Request, **values: object) -> Response:
    locked = await get_site(request).ask(teams.find_lock_date)
    given = {"code": "", "name": "", "email": ""}
    shown = {"made": None, "wrong": None, "given": given, "locked_since": locked, **values}
    return page(request, "teams/join.html", section="/register", **shown)  # type: ignore[arg-type]
