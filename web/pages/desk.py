"""The organizers' desk: what waits for them, each with the form that settles it, and the last lines of the audit log.

The forms call the routes that `vitac admin` calls.
"""

from collections.abc import Callable, Mapping
from typing import Any

from sqlalchemy.orm import Session
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import Response
from vitac.evaluator.figures.figures import SensorFigures
from vitac.evaluator.figures.table import FigureRow, make_rows, reference_figures
from vitac.server.api.appeals import post_appeal, put_ruling, withdraw_appeal
from vitac.server.api.judging import post_conflict, put_marks
from vitac.server.api.members import change_team
from vitac.server.api.messages import hide_question, post_announcement, put_answer, withdraw_announcement
from vitac.server.api.rejudging import apply_rejudgement, discard_rejudgement, post_rejudgement
from vitac.server.competitions.competition import Competition
from vitac.server.database.models import Rejudgement
from vitac.server.decisions import rejudging
from vitac.server.decisions.rejudging import rejudgement_detail_view, rejudgement_view
from vitac.server.decisions.sheet import sheets
from vitac.server.operations.desk import read_desk
from vitac.server.submissions import appeals

from ..site import get_site, page, require_viewer
from .addresses import board_address, competition_address, read_competition_name
from .forms import submit

ADDRESS = "/desk"


async def desk(request: Request) -> Response:
    """Show the desk to an organizer.

    Raises:
        ServiceError: the visitor is none.
    """
    viewer = await require_viewer(request)
    found = await get_site(request).ask(lambda session: read_desk(session, viewer.principal))
    return page(request, "desk.html", viewer=viewer, section=ADDRESS, found=found, board_address=board_address)


async def change(request: Request) -> Response:
    """Make one of the changes of the page's forms."""
    name = request.path_params["action"]
    if name not in CHANGES:
        raise HTTPException(404)
    route, fixed = CHANGES[name]
    return await submit(request, route, back=ADDRESS, fixed=fixed)


CHANGES: Mapping[str, tuple[Callable[..., object], Mapping[str, object]]] = {
    "accept": (change_team, {"accepted": True}),
    "refuse": (change_team, {"accepted": False}),
    "answer": (put_answer, {}),
    "hide": (hide_question, {}),
    "rule": (put_ruling, {}),
    "announce": (post_announcement, {}),
    "withdraw": (withdraw_announcement, {}),
}
"""What the forms of the page do, by the last part of their address."""


REJUDGING_ADDRESS = "/rejudging"


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
    return await submit(request, post_rejudgement, back=REJUDGING_ADDRESS)


async def apply(request: Request) -> Response:
    """Make the new results count, if they are those that the page showed."""
    return await submit(request, apply_rejudgement, back=REJUDGING_ADDRESS)


async def discard(request: Request) -> Response:
    """Leave the present results as they are."""
    return await submit(request, discard_rejudgement, back=REJUDGING_ADDRESS)


JUDGING_ADDRESS = "/judging"
_MARK = "mark-"
"""What the names of the fields with marks begin with."""


async def judging(request: Request) -> Response:
    """Show the judged tracks to a judge or an organizer.

    Raises:
        ServiceError: the visitor is neither.
    """
    viewer = await require_viewer(request)
    found = await get_site(request).ask(lambda session: sheets(session, viewer.principal))
    return page(request, "judging.html", viewer=viewer, section=JUDGING_ADDRESS, found=found, rows=_rows)


async def give_marks(request: Request) -> Response:
    """Keep the marks of a form."""

    def read(fields: Mapping[str, str]) -> Mapping[str, object]:
        marks = {name.removeprefix(_MARK): text for name, text in fields.items() if name.startswith(_MARK)}
        return {**fields, "marks": marks}

    return await submit(request, put_marks, back=JUDGING_ADDRESS, read=read)


async def declare_conflict(request: Request) -> Response:
    """Note that a judge does not judge a team."""
    return await submit(request, post_conflict, back=JUDGING_ADDRESS)


def _rows(figures: SensorFigures) -> list[FigureRow]:
    return list(make_rows(figures, reference_figures()))


APPEALS_ADDRESS = "/appeals"


async def list_appeals(request: Request) -> Response:
    """Show the appeals of the team, all to organizers and judges."""
    viewer = await require_viewer(request)
    by, competition = viewer.principal, read_competition_name(request)
    found = await get_site(request).ask(lambda session: appeals.visible(session, by, competition))
    is_taken = await get_site(request).read(lambda session: appeals.takes_appeals(session, competition))
    given = request.query_params.get("submission", "")
    return page(
        request,
        "appeals.html",
        viewer=viewer,
        section=APPEALS_ADDRESS,
        found=found,
        is_taken=is_taken,
        submission=given,
        appeals_address=_address(request),
    )


async def open_appeal(request: Request) -> Response:
    """Appeal against the newest evaluation of a submission."""
    return await submit(request, post_appeal, back=_address(request))


async def withdraw(request: Request) -> Response:
    """Withdraw an appeal."""
    return await submit(request, withdraw_appeal, back=_address(request))


def _address(request: Request) -> str:
    competition = read_competition_name(request)
    return APPEALS_ADDRESS if competition is None else f"{competition_address(competition)}{APPEALS_ADDRESS}"
