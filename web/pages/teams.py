"""Pages of a team: signing in and out, its members, tokens and quotas."""

import asyncio
from collections.abc import Mapping
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from http import HTTPStatus
from types import MappingProxyType
from uuid import UUID

from sqlalchemy.orm import Session
from starlette.requests import Request
from starlette.responses import RedirectResponse, Response
from vitac.server.accounts import members, passwords, teams, tokens
from vitac.server.api import members as routes
from vitac.server.api.access import get_client_address, member_key, note_password
from vitac.server.api.middleware.shares import leave_place
from vitac.server.api.teams import post_team
from vitac.server.database.states import MemberRole, NoticeKind
from vitac.server.errors import ProblemCode, ServiceError
from vitac.server.operations import team_data
from vitac.server.principals import Principal
from vitac.server.views.teams import OwnTeamView, TokenView

from .. import session as signer
from ..session import local_target, read_form
from ..site import get_site, get_viewer, none_if_unknown, page, require_form_token, require_viewer, signed_in_form
from .forms import Fields, call

WRONG_TOKEN = "This token is unknown, revoked or expired. Check that you pasted it completely."  # noqa: S105 - a sentence


WRONG_PASSWORD = "No member of that name and team has this password. Check all three."  # noqa: S105 - a sentence
NOBODY = {"team": "", "member": ""}


async def sign_in_form(request: Request) -> Response:
    """Show the sign-in form."""
    target = local_target(request.query_params.get("next", ""))
    return await _page(request, next=target)


async def sign_in(request: Request) -> Response:
    """Check the token and begin a session."""
    fields = await read_form(request)
    target = local_target(fields.get("next", ""))
    token = fields.get("token", "").strip()
    by = await none_if_unknown(get_site(request).read(lambda session: tokens.authenticate(session, token)))
    if by is None or by.token_id is None:
        return await _page(request, status=401, next=target, wrong=WRONG_TOKEN)
    answer = RedirectResponse(target, status_code=303)
    begin_session(request, answer, by.token_id)
    return answer


async def sign_in_with_password(request: Request) -> Response:
    """Check a member's password and begin a session."""
    fields = await read_form(request)
    target = local_target(fields.get("next", ""))
    shown = {name: fields.get(name, "") for name in NOBODY}
    try:
        by = await _find_member(request, **shown, password=fields.get("password", ""))
    except ServiceError as error:
        if error.code is not ProblemCode.TOO_MANY_REQUESTS:
            raise
        return await _page(request, status=error.status, next=target, wrong_password=error.detail, given=shown)
    if by is None or by.token_id is None:
        return await _page(request, status=401, next=target, wrong_password=WRONG_PASSWORD, given=shown)
    answer = RedirectResponse(target, status_code=303)
    begin_session(request, answer, by.token_id)
    _remember_device(request, answer, member_key(shown["team"], shown["member"]))
    return answer


async def _find_member(request: Request, team: str, member: str, password: str) -> Principal | None:
    """Begin a session of a member and return who it is; None if nobody has this password.

    Raises:
        ServiceError: there were too many attempts.
    """
    site = get_site(request)
    cookie = request.cookies.get(signer.DEVICE_COOKIE)
    device = site.signer.read_device(cookie, member_key(team, member), now=datetime.now(UTC))
    wait_s = await asyncio.to_thread(note_password, request, team, member, device=device)
    thread = passwords.UNKNOWN_DEVICES if device is None else passwords.KNOWN_DEVICES
    with request.app.state.sign_in_limiters.place(get_client_address(request), device=device):
        leave_place(request)  # not before: pages that refuse are made in turn with those of others
        await asyncio.sleep(wait_s)
        made = await none_if_unknown(
            thread.wait_for(members.sign_in, site.services.database, team, member, password, signer.LIFETIME)
        )
    if made is None:
        return None
    return await site.read(lambda session: tokens.principal_of_token_id(session, made.id))


async def _page(request: Request, **values: object) -> Response:
    shown = {"viewer": await get_viewer(request), "wrong": None, "wrong_password": None, "given": NOBODY, **values}
    return page(request, "sign_in.html", section="/sign-in", **shown)  # type: ignore[arg-type]


def begin_session(request: Request, answer: Response, token_id: UUID, *, expires_at: datetime | None = None) -> None:
    """Let the browser be signed in with a token from this answer on; `expires_at` None: for the usual time."""
    begun = signer.begin(token_id, now=datetime.now(UTC))
    session = begun if expires_at is None else replace(begun, expires_at=expires_at)
    _set_cookie(request, answer, signer.COOKIE, get_site(request).signer.sign(session), signer.LIFETIME)


def _remember_device(request: Request, answer: Response, member: str) -> None:
    """Let the browser be known as one on which a member has signed in: nobody else uses up its attempts."""
    value = get_site(request).signer.sign_device(member, now=datetime.now(UTC))
    _set_cookie(request, answer, signer.DEVICE_COOKIE, value, signer.DEVICE_LIFETIME)


def _set_cookie(request: Request, answer: Response, name: str, value: str, lifetime: timedelta) -> None:
    answer.set_cookie(
        name,
        value,
        max_age=int(lifetime.total_seconds()),
        httponly=True,
        samesite="strict",
        secure=request.url.scheme == "https",
    )


async def sign_out(request: Request) -> Response:
    """End the session."""
    fields = await read_form(request)
    viewer = await get_viewer(request)
    if viewer is not None:
        require_form_token(request, fields, viewer)
        await get_site(request).ask(lambda session: tokens.end_session(session, viewer.principal))
    answer = RedirectResponse("/", status_code=303)
    answer.delete_cookie(signer.COOKIE, httponly=True, samesite="strict", secure=request.url.scheme == "https")
    return answer


FIELDS = ("name", "contact", "invite")
IN_FORM = frozenset(
    {ProblemCode.INVALID_REQUEST, ProblemCode.INVITE_REQUIRED, ProblemCode.TEAM_EXISTS, ProblemCode.TOO_MANY_REQUESTS}
)
"""Refusals that are shown above the form, so that it can be corrected."""
NOTHING = dict.fromkeys(FIELDS, "")


async def register_form(request: Request) -> Response:
    """Show the form."""
    return await _register_page(request, viewer=await get_viewer(request), given=NOTHING)


async def register(request: Request) -> Response:
    """Register the team, show its token and begin a session."""
    fields = await read_form(request)
    given = {name: fields.get(name, "").strip() for name in FIELDS}
    try:
        made = await call(request, post_team, None, given)
    except ServiceError as error:
        if error.code not in IN_FORM:
            raise
        viewer = await get_viewer(request)
        return await _register_page(request, viewer=viewer, given=given, wrong=error.detail, status=error.status)
    answer = await _register_page(
        request, viewer=None, viewer_known=False, given=NOTHING, made=made, status=HTTPStatus.CREATED
    )
    answer.headers["Cache-Control"] = "no-store"
    begin_session(request, answer, made.token.id)
    return answer


async def _register_page(request: Request, **values: object) -> Response:
    shown = {"made": None, "wrong": None, "locked_since": await get_site(request).ask(teams.find_lock_date), **values}
    return page(request, "register.html", section="/register", **shown)  # type: ignore[arg-type]


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
        good = [tokens.token_view(token) for token in tokens.list_tokens(session, by) if token.revoked_at is None]
        return members.own_team_view(session, by, teams.own(session, by)), good, teams.find_lock_date(session)

    own_view, good, locked_since = await get_site(request).ask(read)
    myself = next(
        (
            one
            for one in own_view.members
            if one.id == by.member_id or (by.leads_team and one.role is MemberRole.CAPTAIN)
        ),
        None,
    )
    return page(
        request,
        "teams/team.html",
        viewer=viewer,
        section=ADDRESS,
        found=own_view,
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
    exported = await get_site(request).ask(
        lambda session: team_data.export(session, settings, by, teams.own(session, by))
    )
    headers = {"Cache-Control": "no-store", "Content-Disposition": 'attachment; filename="team.json"'}
    return Response(exported.model_dump_json(indent=1), media_type="application/json", headers=headers)


async def invite(request: Request) -> Response:
    """Make an invitation and show its code once."""
    viewer, fields = await signed_in_form(request)
    made = await call(request, routes.invite_member, viewer.principal, fields, ids=own_team(None, viewer.principal))
    return page(
        request, "teams/secret.html", viewer=viewer, section=ADDRESS, status=201, what="invitation", secret=made.code
    )


async def renew_token(request: Request) -> Response:
    """Make a new token for the member who asks and show it once; the browser stays signed in."""
    viewer, fields = await signed_in_form(request)
    ids = await get_site(request).read(lambda session: own_member(session, viewer.principal))
    token = await call(request, routes.renew_member_token, viewer.principal, fields, ids=ids)
    shown = {"viewer_known": False, "what": "token", "secret": token.secret}  # the earlier session has ended
    answer = page(request, "teams/secret.html", viewer=None, section=ADDRESS, status=HTTPStatus.CREATED, **shown)
    answer.headers["Cache-Control"] = "no-store"
    begin_session(request, answer, token.id, expires_at=viewer.expires_at)
    return answer


async def join_form(request: Request) -> Response:
    """Show the form with which somebody joins a team."""
    return await _join_page(request, viewer=await get_viewer(request))


async def join(request: Request) -> Response:
    """Make somebody with an invitation a member, show their token and begin a session."""
    fields = await read_form(request)
    given = {name: fields.get(name, "").strip() for name in ("code", "name", "email")}
    try:
        joined = await call(request, routes.join_team, None, {**fields, **given})
    except ServiceError as error:
        viewer = await get_viewer(request)
        return await _join_page(request, viewer=viewer, wrong=error.detail, given=given, status=error.status)
    answer = await _join_page(request, viewer=None, status=HTTPStatus.CREATED, made=joined, viewer_known=False)
    answer.headers["Cache-Control"] = "no-store"
    begin_session(request, answer, joined.token.id)
    return answer


def own_team(_: object, by: Principal) -> Mapping[str, object]:
    """Return the id of the team that asks."""
    return {"team_id": by.team_id}


def own_member(session: Session, by: Principal) -> Mapping[str, object]:
    """Return the ids of the member who asks; the shared token of a team without another one is its captain's."""
    team = teams.own(session, by)
    return {"team_id": team.id, "member_id": by.member_id or members.find_captain(session, team).id}


def read_email(fields: Fields) -> Mapping[str, object]:
    """Return the address of a form; an empty one takes it away."""
    return {"email": fields.get("email", "").strip() or None}


def read_password(fields: Fields) -> Mapping[str, object]:
    """Return the new password of a form; an empty one takes it away."""
    return {"password": fields.get("password") or None}


def read_muted(fields: Fields) -> Mapping[str, object]:
    """Return the kinds of notices whose box is not ticked; browsers leave those out."""
    return {"muted": [kind for kind in NOTICES if kind.value not in fields]}


async def _join_page(request: Request, **values: object) -> Response:
    locked = await get_site(request).ask(teams.find_lock_date)
    given = {"code": "", "name": "", "email": ""}
    shown = {"made": None, "wrong": None, "given": given, "locked_since": locked, **values}
    return page(request, "teams/join.html", section="/register", **shown)  # type: ignore[arg-type]
