"""The organizers' page of rejudgements: what would change, and the forms that start, apply and discard one."""

from typing import Any

from sqlalchemy.orm import Session
from starlette.requests import Request
from starlette.responses import Response
from vitac.server.api.rejudging import apply_rejudgement, discard_rejudgement, post_rejudgement
from vitac.server.competitions.competition import Competition
from vitac.server.database.models import Rejudgement
from vitac.server.decisions import rejudging
from vitac.server.decisions.rejudging import rejudgement_detail_view, rejudgement_view

from ..site import get_site, page, require_viewer
from .forms import submit

ADDRESS = "/rejudging"


async def rejudgements(request: Request) -> Response:
    """Show open rejudgements with what they would change, and those that have ended.

    Raises:
        ServiceError: the visitor is no organizer.
    """
    viewer, site = await require_viewer(request), get_site(request)

    def read(session: Session) -> dict[str, Any]:
        found = rejudging.rejudgements(session, viewer.principal)
        competitions = [one for one in Competition.read_all(session) if viewer.principal.organizes(one.name)]
        ended = [one for one in found if one.applied_at or one.discarded_at]
        open_ones = [rejudgement_detail_view(session, one) for one in found if one not in ended]
        return {
            "open_ones": open_ones,
            "ended": [rejudgement_view(one) for one in ended],
            "places": {one.id: _place(session, one) for one in found},
            "titles": {name: Competition.find_by_track(session, name).track_title(name) for name in site.tracks},
            "competitions": competitions if len(competitions) > 1 else [],
        }

    shown = await site.ask(read)
    return page(
        request,
        "rejudging.html",
        viewer=viewer,
        section="/desk",
        tracks=site.tracks,
        **shown,
    )


def _place(session: Session, found: Rejudgement) -> str:
    """Return in words which stage is evaluated again, with its competition where there are several."""
    competitions = Competition.read_all(session)
    competition = next((one for one in competitions if one.name == found.competition), None)
    titled = competition or Competition.find_by_track(session, found.track)
    words = [titled.track_title(found.track)]
    if competition is not None and len(competitions) > 1:
        words.insert(0, competition.definition.title)
    if found.stage:
        words.append(titled.stage_titles.get((found.track, found.stage), found.stage))
    return ", ".join(words)


async def start(request: Request) -> Response:
    """Evaluate the models of a stage again."""
    return await submit(request, post_rejudgement, back=ADDRESS)


async def apply(request: Request) -> Response:
    """Make the new results count, if they are those that the page showed."""
    return await submit(request, apply_rejudgement, back=ADDRESS)


async def discard(request: Request) -> Response:
    """Leave the present results as they are."""
    return await submit(request, discard_rejudgement, back=ADDRESS)
