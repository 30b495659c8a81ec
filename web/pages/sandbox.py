"""The page that says what a policy runs with, as the workers found it in their sandboxes."""

from starlette.requests import Request
from starlette.responses import Response
from vitac.server.queue.workers import sandboxes

from ..limits import limit_rows
from ..site import get_site, get_viewer, page


async def sandbox(request: Request) -> Response:
    """Show packages, BLAS, threads, CPU and limits, and how to bring other packages."""
    site = get_site(request)
    settings = site.services.settings
    return page(
        request,
        "sandbox.html",
        viewer=await get_viewer(request),
        section="/sandbox",
        found=await site.ask(lambda session: sandboxes(session, settings)),
        limits=limit_rows(settings.limits),
    )
