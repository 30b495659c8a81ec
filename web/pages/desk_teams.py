"""All teams for organizers: notes, filters, one change for several of them, and the teams of a CSV file."""

from collections.abc import Mapping
from typing import Any

from sqlalchemy.orm import Session
from starlette.requests import Request
from starlette.responses import Response
from vitac.server.accounts.team_lists import BulkAction, TeamSearch, list_teams
from vitac.server.api.teams import import_teams
from vitac.server.competitions.view import competition_list_view
from vitac.server.views.teams import TeamState

from ..site import get_site, page, require_viewer, signed_in_form
from .forms import call, list_ticked

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


def read_teams(fields: Mapping[str, str]) -> Mapping[str, object]:
    """Return the ticked teams."""
    return {"teams": list_ticked(fields, _TEAM)}


async def import_file(request: Request) -> Response:
    """Add the teams of a pasted CSV file, and show the invitations once."""
    viewer, fields = await signed_in_form(request)
    made = await call(request, import_teams, viewer.principal, fields)
    return page(request, "desk_imported.html", viewer=viewer, section="/desk", status=201, made=made)
