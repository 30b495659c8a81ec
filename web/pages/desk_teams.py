"""All teams for organizers: notes, filters, one change for several of them, and the teams of a CSV file."""

from collections.abc import Mapping
from typing import Any

from sqlalchemy.orm import Session
from starlette.requests import Request
from starlette.responses import Response
from vitac.server.accounts.team_lists import BulkAction, TeamSearch, list_teams
from vitac.server.api.members import put_note
from vitac.server.api.teams import TeamsFile, change_teams, import_teams
from vitac.server.competitions.view import competition_list_view
from vitac.server.views.teams import TeamState

from ..site import get_site, page, require_viewer, signed_in_form
from .forms import checked_form, list_ticked, submit

ADDRESS = "/desk/teams"
_TEAM = "team-"


async def teams(request: Request) -> Response:
    """Show the teams that a search finds to an organizer of the service.

    Raises:
        ServiceError: the visitor is none.
    """
    viewer, query = await require_viewer(request), request.query_params
    state = query.get("state", "")
    search = TeamSearch(
        text=query.get("q", "").strip()[:64],
        state=TeamState(state) if state in set(TeamState) else None,
        competition=query.get("competition") or None,
    )

    def read(session: Session) -> dict[str, Any]:
        return {
            "found": list_teams(session, viewer.principal, search),
            "competitions": competition_list_view(session).items,
        }

    shown = await get_site(request).read(read)
    return page(
        request,
        "desk_teams.html",
        viewer=viewer,
        section="/desk",
        search=search,
        states=list(TeamState),
        actions=list(BulkAction),
        **shown,
    )


async def change_several(request: Request) -> Response:
    """Do the same with the ticked teams."""

    def read(fields: Mapping[str, str]) -> Mapping[str, object]:
        return {**fields, "teams": list_ticked(fields, _TEAM)}

    return await submit(request, change_teams, back=ADDRESS, read=read)


async def change_note(request: Request) -> Response:
    """Keep the note about a team; an empty one removes it."""
    return await submit(request, put_note, back=ADDRESS)


async def import_file(request: Request) -> Response:
    """Add the teams of a pasted CSV file, and show the invitations once."""
    viewer, fields = await signed_in_form(request)
    site, new = get_site(request), checked_form(TeamsFile, {"csv": fields.get("csv", "")})
    made = await site.run(lambda: import_teams(site.services, viewer.principal, new))
    return page(request, "desk_imported.html", viewer=viewer, section="/desk", status=201, made=made)
