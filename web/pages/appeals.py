"""Appeals: those that a visitor may see, with the form that opens one."""

from starlette.requests import Request
from starlette.responses import Response
from vitac.server.api.appeals import post_appeal, withdraw_appeal
from vitac.server.appeals import appeals

from ..site import get_site, page, require_viewer
from .addresses import competition_address, read_competition_name
from .forms import submit

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
    return await submit(request, post_appeal, back=_address(request))


async def withdraw(request: Request) -> Response:
    """Withdraw an appeal."""
    return await submit(request, withdraw_appeal, back=_address(request))


def _address(request: Request) -> str:
    competition = read_competition_name(request)
    return ADDRESS if competition is None else f"{competition_address(competition)}{ADDRESS}"
