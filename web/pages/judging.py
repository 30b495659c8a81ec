"""The page of judges: entries with figures, the form of marks, conflicts of interest; for organizers totals."""

from collections.abc import Mapping

from starlette.requests import Request
from starlette.responses import Response
from vitac.evaluator.figures.figures import SensorFigures
from vitac.evaluator.figures.table import FigureRow, make_rows, reference_figures
from vitac.server.api.judging import post_conflict, put_marks
from vitac.server.decisions.sheet import sheets

from ..site import get_site, page, require_viewer
from .forms import submit

ADDRESS = "/judging"
_MARK = "mark-"
"""What the names of the fields with marks begin with."""


async def judging(request: Request) -> Response:
    """Show the judged tracks to a judge or an organizer.

    Raises:
        ServiceError: the visitor is neither.
    """
    viewer = await require_viewer(request)
    found = await get_site(request).ask(lambda session: sheets(session, viewer.principal))
    return page(request, "judging.html", viewer=viewer, section=ADDRESS, found=found, rows=_rows)


async def give_marks(request: Request) -> Response:
    """Keep the marks of a form."""

    def read(fields: Mapping[str, str]) -> Mapping[str, object]:
        marks = {name.removeprefix(_MARK): text for name, text in fields.items() if name.startswith(_MARK)}
        return {**fields, "marks": marks}

    return await submit(request, put_marks, back=ADDRESS, read=read)


async def declare_conflict(request: Request) -> Response:
    """Note that a judge does not judge a team."""
    return await submit(request, post_conflict, back=ADDRESS)


def _rows(figures: SensorFigures) -> list[FigureRow]:
    return list(make_rows(figures, reference_figures()))
