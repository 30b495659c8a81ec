"""The organizers' page of rejudgements: what would change, and the forms that start, apply and discard one."""

from collections.abc import Mapping
from typing import Any

from sqlalchemy.orm import Session
from starlette.requests import Request
from starlette.responses import Response
from vitac.server.contest.contest import Contest
from vitac.server.db.models import Rejudgement
from vitac.server.principals import Principal
from vitac.server.rejudging import rejudging
from vitac.server.rejudging.view import rejudgement_detail_view, rejudgement_view

from ..site import get_site, page, require_viewer
from .forms import act, read_id

ADDRESS = "/rejudging"


async def rejudgements(request: Request) -> Response:
    """Show open rejudgements with what they would change, and those that have ended.

    Raises:
        ServiceError: the visitor is no organizer.
    """
    viewer, site = await require_viewer(request), get_site(request)

    def read(session: Session) -> dict[str, Any]:
        found = rejudging.rejudgements(session, viewer.principal)
        contests = [one for one in Contest.read_all(session) if viewer.principal.organizes(one.name)]
        ended = [one for one in found if one.applied_at or one.discarded_at]
        open_ones = [rejudgement_detail_view(session, one) for one in found if one not in ended]
        return {
            "open_ones": open_ones,
            "ended": [rejudgement_view(one) for one in ended],
            "places": {one.id: _place(session, one) for one in found},
            "titles": {name: Contest.find_by_track(session, name).track_title(name) for name in site.tracks},
            "contests": contests if len(contests) > 1 else [],
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
    contests = Contest.read_all(session)
    contest = next((one for one in contests if one.name == found.contest), None)
    titled = contest or Contest.find_by_track(session, found.track)
    words = [titled.track_title(found.track)]
    if contest is not None and len(contests) > 1:
        words.insert(0, contest.definition.title)
    if found.stage:
        words.append(titled.stage_titles.get((found.track, found.stage), found.stage))
    return ", ".join(words)


async def start(request: Request) -> Response:
    """Evaluate the models of a stage again."""

    def started(session: Session, by: Principal, fields: Mapping[str, str]) -> None:
        named = fields.get("stage", "").strip() or None
        track = fields.get("track", "")
        contest = fields.get("contest") or by.contest
        stage = Contest.find_by_track(session, track, contest).shown_stage(track, named)
        rejudging.start(session, by, stage, reason=fields.get("reason", ""))

    return await act(request, started, back=ADDRESS)


async def apply(request: Request) -> Response:
    """Make the new results count, if they are those that the page showed."""

    def applied(session: Session, by: Principal, fields: Mapping[str, str]) -> None:
        rejudging.apply(session, by, read_id(fields, "id"), shown=fields.get("shown", ""))

    return await act(request, applied, back=ADDRESS)


async def discard(request: Request) -> Response:
    """Leave the present results as they are."""
    return await act(
        request, lambda session, by, fields: rejudging.discard(session, by, read_id(fields, "id")), back=ADDRESS
    )
