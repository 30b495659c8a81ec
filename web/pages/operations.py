"""The organizers' page *Operations*: the state of the service at a glance, the same figures as `/metrics`."""

from starlette.requests import Request
from starlette.responses import Response
from vitac.server.database.metrics import totals
from vitac.server.errors import ProblemCode, ServiceError
from vitac.server.operations import state
from vitac.server.queue.workers import measure_disk

from ..site import get_site, page, require_viewer


async def operations(request: Request) -> Response:
    """Show queue, workers, storage and counts to an organizer.

    Raises:
        ServiceError: the visitor is a team.
    """
    viewer = await require_viewer(request)
    if not viewer.organizes_service:
        raise ServiceError(ProblemCode.FORBIDDEN, "This page is for organizers. Sign in with an organizer's token.")
    site = get_site(request)
    settings = site.services.settings
    found = await site.ask(lambda session: state.operations(session, settings, totals(session)))
    disk = measure_disk(settings.state_dir)
    return page(request, "operations.html", viewer=viewer, section="/operations", found=found, disk=disk)
