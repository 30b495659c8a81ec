"""Appeals: those that a visitor may see, with the form that opens one."""

from collections.abc import Mapping

from sqlalchemy.orm import Session
from starlette.requests import Request
from starlette.responses import Response
from vitac.server.appeals import appeals
from vitac.server.principals import Principal

from ..site import get_site, page, require_viewer
from .addresses import competition_address, read_competition_name
from .forms import act, read_id, read_number

ADDRESS = "/appeals"


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
        section=ADDRESS,
        found=found,
        is_taken=is_taken,
        submission=given,
        appeals_address=_address(request),
    )


async def open_appeal(request: Request) -> Response:
    """Appeal against the newest evaluation of a submission."""

    def opened(session: Session, by: Principal, fields: Mapping[str, str]) -> object:
        task = fields.get("task", "").strip() or None
        episode = read_number(fields, "episode") if fields.get("episode", "").strip() else None
        text = fields.get("text", "")
        return appeals.open_appeal(session, by, read_id(fields, "submission"), text, task=task, episode=episode)

    return await act(request, opened, back=_address(request))


async def withdraw(request: Request) -> Response:
    """Withdraw an appeal."""
    return await act(
        request,
        lambda session, by, fields: appeals.withdraw(session, by, read_number(fields, "id")),
        back=_address(request),
    )


def _address(request: Request) -> str:
    competition = read_competition_name(request)
    return ADDRESS if competition is None else f"{competition_address(competition)}{ADDRESS}"
