"""The organizers' desk: what waits for them, each with a form that settles it, and the end of the audit log."""

from collections.abc import Mapping
from typing import Any

from sqlalchemy.orm import Session
from starlette.requests import Request
from starlette.responses import Response
from vitac.evaluator.figures.figures import SensorFigures
from vitac.evaluator.figures.table import FigureRow, make_rows, reference_figures
from vitac.server.competitions.competition import Competition
from vitac.server.database.models import Rejudgement
from vitac.server.decisions import rejudging
from vitac.server.decisions.rejudging import rejudgement_detail_view, rejudgement_view
from vitac.server.decisions.sheet import sheets
from vitac.server.operations.desk import read_desk
from vitac.server.submissions import appeals

from ..site import get_site, page, require_viewer
from .addresses import board_address, competition_address, read_competition_name

ADDRESS = "/desk"


async def desk(request: Request) -> Response:
    """Show the desk to an organizer.

    Raises:
        ServiceError: the visitor is none.
    """
    viewer = await require_viewer(request)
    work = await get_site(request).ask(lambda session: read_desk(session, viewer.principal))
    return page(request, "desk.html", viewer=viewer, section=ADDRESS, found=work, board_address=board_address)


REJUDGING_ADDRESS = "/rejudging"


async def rejudgements(request: Request) -> Response:
    """Show open rejudgements with what they would change, and those that have ended.

    Raises:
        ServiceError: the visitor is no organizer.
    """
    viewer, site = await require_viewer(request), get_site(request)

    def read(session: Session) -> dict[str, Any]:
        listed = rejudging.rejudgements(session, viewer.principal)
        competitions = [one for one in Competition.read_all(session) if viewer.principal.organizes(one.name)]
        ended = [one for one in listed if one.applied_at or one.discarded_at]
        open_ones = [rejudgement_detail_view(session, one) for one in listed if one not in ended]
        return {
            "open_ones": open_ones,
            "ended": [rejudgement_view(one) for one in ended],
            "places": {one.id: _place(session, one) for one in listed},
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


def _place(session: Session, rejudgement: Rejudgement) -> str:
    """Return in words which stage is evaluated again, with its competition where there are several."""
    competitions = Competition.read_all(session)
    competition = next((one for one in competitions if one.name == rejudgement.competition), None)
    titled = competition or Competition.find_by_track(session, rejudgement.track)
    words = [titled.track_title(rejudgement.track)]
    if competition is not None and len(competitions) > 1:
        words.insert(0, competition.definition.title)
    if rejudgement.stage:
        words.append(titled.stage_titles.get((rejudgement.track, rejudgement.stage), rejudgement.stage))
    return ", ".join(words)


JUDGING_ADDRESS = "/judging"
_MARK = "mark-"
"""What the names of the fields with marks begin with."""


async def judging(request: Request) -> Response:
    """Show the judged tracks to a judge or an organizer.

    Raises:
        ServiceError: the visitor is neither.
    """
    viewer = await require_viewer(request)
    own_sheets = await get_site(request).ask(lambda session: sheets(session, viewer.principal))
    return page(request, "judging.html", viewer=viewer, section=JUDGING_ADDRESS, found=own_sheets, rows=_rows)


def read_marks(fields: Mapping[str, str]) -> Mapping[str, object]:
    """Return the marks of a form."""
    return {"marks": {name.removeprefix(_MARK): text for name, text in fields.items() if name.startswith(_MARK)}}


def _rows(figures: SensorFigures) -> list[FigureRow]:
    return list(make_rows(figures, reference_figures()))


APPEALS_ADDRESS = "/appeals"


async def list_appeals(request: Request) -> Response:
    """Show the appeals of the team, all to organizers and judges."""
    viewer = await require_viewer(request)
    by, competition = viewer.principal, read_competition_name(request)
    listed = await get_site(request).ask(lambda session: appeals.visible(session, by, competition))
    is_taken = await get_site(request).read(lambda session: appeals.takes_appeals(session, competition))
    given = request.query_params.get("submission", "")
    return page(
        request,
        "appeals.html",
        viewer=viewer,
        section=APPEALS_ADDRESS,
        found=listed,
        is_taken=is_taken,
        submission=given,
        appeals_address=_address(request),
    )


def _address(request: Request) -> str:
    competition = read_competition_name(request)
    return APPEALS_ADDRESS if competition is None else f"{competition_address(competition)}{APPEALS_ADDRESS}"
