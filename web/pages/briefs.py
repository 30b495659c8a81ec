"""Briefs of a stage: the own team's, handed in with a form; for judges and organizers all, to be decided about."""

from collections.abc import Mapping
from datetime import UTC, datetime

from sqlalchemy.orm import Session
from starlette.requests import Request
from starlette.responses import RedirectResponse, Response
from vitac.server.api import by_hand
from vitac.server.competitions.competition import Competition
from vitac.server.competitions.stages import Stage
from vitac.server.errors import ServiceError
from vitac.server.principals import Audience
from vitac.server.submissions import briefs
from vitac.server.views.by_hand import BriefView

from ..session import read_file_form
from ..site import Viewer, get_site, page, require_form_token, require_viewer
from .forms import fetch

STAGE = "/competitions/{competition}/tracks/{track}/stages/{stage}"
ADDRESS = f"{STAGE}/briefs"
OWN = "/briefs/own"
"""Where the form sends a brief: below it, uploads have limits of their own."""


async def show(request: Request) -> Response:
    """Show the own team's brief and the form, or all to judges and organizers.

    Raises:
        ServiceError: there is no such stage, or it takes no briefs.
    """
    return await _show(request, await require_viewer(request), request.path_params)


async def hand_in(request: Request) -> Response:
    """Receive a brief and go back; a refusal is shown above the form."""
    viewer = await require_viewer(request)
    form = await read_file_form(request)
    require_form_token(request, form.fields, viewer)
    place = {name: form.fields.get(name, "") for name in ("competition", "track", "stage")}
    try:
        Audience.TEAMS.require(viewer.principal, None)
        await by_hand.receive_brief(get_site(request).services, viewer.principal, form.pieces, **place)
    except ServiceError as error:
        await form.discard()
        return await _show(request, viewer, place, wrong=error.detail, status=error.status)
    return RedirectResponse(ADDRESS.format(**place), status_code=303)


async def document(request: Request) -> Response:
    """Answer with the PDF of a brief."""
    return await fetch(request, by_hand.get_brief)


def read_decision(fields: Mapping[str, str]) -> Mapping[str, object]:
    """Return whether the button that was pressed accepts."""
    return {"accepted": fields.get("decision") == "accept"}


async def _show(
    request: Request, viewer: Viewer, place: Mapping[str, str], *, wrong: str | None = None, status: int = 200
) -> Response:
    def read(session: Session) -> tuple[Stage, str, list[BriefView], bool]:
        competition = Competition.find(session, place["competition"])
        stage = competition.stage(place["track"], place["stage"])
        listed = [briefs.brief_view(brief) for brief in briefs.list_briefs(session, viewer.principal, stage)]
        return stage, competition.definition.title, listed, competition.row.finalized_at is not None

    stage, title, listed, is_final = await get_site(request).read(read)
    now = datetime.now(UTC)
    return page(
        request,
        "briefs.html",
        viewer=viewer,
        section="/competition",
        status=status,
        wrong=wrong,
        rules=stage.rules,
        title=title,
        track_title=stage.track_rules.title,
        place=dict(place),
        briefs_address=ADDRESS.format(**place),
        found=listed,
        is_open=stage.rules.opens <= now < stage.rules.closes,
        may_decide=not viewer.principal.team_id and stage.is_over(now) and not is_final,
    )
