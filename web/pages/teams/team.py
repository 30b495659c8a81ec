"""The team's page: members, invitations, tokens and sessions, each with its forms; and the page that joins a team."""

from collections.abc import Mapping
from datetime import datetime
from http import HTTPStatus
from types import MappingProxyType

from sqlalchemy.orm import Session
from starlette.requests import Request
from starlette.responses import Response
from vitac.server.accounts import members, teams, tokens
from vitac.server.api import members as routes
from vitac.server.database.states import MemberRole, NoticeKind
from vitac.server.errors import ServiceError
from vitac.server.operations import team_data
from vitac.server.principals import Principal
from vitac.server.views.teams import OwnTeamView, TokenView

from ...session.signer import read_form
from ...site import get_site, get_viewer, page, require_viewer, signed_in_form
from ..forms import Fields, call
from .sign_in import begin_session

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
