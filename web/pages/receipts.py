"""The page of the log of receipts, for everybody, and the receipt of a submission as a file."""

from starlette.requests import Request
from starlette.responses import Response
from vitac.server.submissions import receipts as of_submissions

from ..site import get_site, get_viewer, page, require_viewer
from .addresses import as_id, read_competition_name


async def receipts(request: Request) -> Response:
    """Show the public key, how long the log is, who witnesses it, and how to check a receipt."""
    competition = read_competition_name(request)
    return page(
        request,
        "receipts.html",
        viewer=await get_viewer(request),
        section="/receipts",
        competition=competition,
        log=await get_site(request).ask(
            lambda session: of_submissions.log_view(session, after=0, limit=0, competition=competition)
        ),
    )


async def receipt_file(request: Request) -> Response:
    """Return the receipt of a submission's newest result."""
    viewer = await require_viewer(request)
    submission_id = as_id(request.path_params["submission_id"])
    found = await get_site(request).ask(
        lambda session: of_submissions.newest_receipt(session, viewer.principal, submission_id)
    )
    name = f"receipt-{found.entry.number}.json"
    return Response(
        found.model_dump_json(indent=1),
        media_type="application/json",
        headers={"Content-Disposition": f'attachment; filename="{name}"'},
    )
