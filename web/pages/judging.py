"""The page of judges: entries with figures, the form of marks, conflicts of interest; for organizers totals."""

from collections.abc import Mapping

from sqlalchemy.orm import Session
from starlette.requests import Request
from starlette.responses import Response
from vitac.evaluator.figures.figures import SensorFigures
from vitac.evaluator.figures.table import FigureRow, make_rows, reference_figures
from vitac.server.decisions import judging as marking
from vitac.server.decisions.sheet import sheets
from vitac.server.errors import ProblemCode, ServiceError
from vitac.server.principals import Principal

from ..site import get_site, page, require_viewer
from .forms import act, read_id

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

    def given(session: Session, by: Principal, fields: Mapping[str, str]) -> None:
        marks = {name.removeprefix(_MARK): _mark(text) for name, text in fields.items() if name.startswith(_MARK)}
        marking.give_marks(session, by, read_id(fields, "id"), marks, judge=_judge(fields))

    return await act(request, given, back=ADDRESS)


async def declare_conflict(request: Request) -> Response:
    """Note that a judge does not judge a team."""

    def declared(session: Session, by: Principal, fields: Mapping[str, str]) -> None:
        reason = " ".join(fields.get("reason", "").split())
        if not 1 <= len(reason) <= 500:
            raise ServiceError(
                ProblemCode.INVALID_REQUEST, f"Expected a reason of 1 to 500 characters, got {len(reason)}."
            )
        marking.declare_conflict(session, by, fields.get("team", ""), reason, judge=_judge(fields))

    return await act(request, declared, back=ADDRESS)


def _judge(fields: Mapping[str, str]) -> str | None:
    return fields.get("judge", "").strip()[:100] or None


def _mark(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise ServiceError(ProblemCode.INVALID_REQUEST, f"Expected a mark from 0 to 10, got {text!r:.40}.") from None


def _rows(figures: SensorFigures) -> list[FigureRow]:
    return list(make_rows(figures, reference_figures()))
