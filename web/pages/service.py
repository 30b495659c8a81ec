"""The organizers' page *Operations*: the state of the service at a glance, the same figures as `/metrics`."""

import asyncio
from typing import Any, cast

from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import FileResponse, Response
from vitac.server.api.health import get_ready
from vitac.server.database.metrics import totals
from vitac.server.errors import ProblemCode, ServiceError
from vitac.server.operations import state
from vitac.server.queue.workers import measure_disk, sandboxes
from vitac.server.submissions import files as of_submissions

from ..documentation.library import ADDRESS, INDEX, MAX_FOUND, Library, is_document
from ..headers import limit_rows
from ..site import get_site, get_viewer, page, require_viewer
from .addresses import as_id, read_competition_name


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
    state_now = await site.ask(lambda session: state.operations(session, settings, totals(session)))
    disk = measure_disk(settings.state_dir)
    return page(request, "operations.html", viewer=viewer, section="/operations", found=state_now, disk=disk)


async def status(request: Request) -> Response:
    """Show whether the service can do its work, part by part."""
    answer = Response()
    ready = await get_ready(get_site(request).services, answer)
    return page(
        request,
        "status.html",
        viewer=await get_viewer(request),
        section="/status",
        status=answer.status_code,
        found=ready,
    )


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
    receipt = await get_site(request).ask(
        lambda session: of_submissions.newest_receipt(session, viewer.principal, submission_id)
    )
    name = f"receipt-{receipt.entry.number}.json"
    return Response(
        receipt.model_dump_json(indent=1),
        media_type="application/json",
        headers={"Content-Disposition": f'attachment; filename="{name}"'},
    )


def get_library(request: Request) -> Library:
    """Return the documents, which `routes.install` stored in the application."""
    return cast("Library", request.app.state.library)


async def documentation(request: Request) -> Response:
    """Show a document, or answer with a file that one links to."""
    library = get_library(request)
    name = request.path_params["name"] or INDEX
    path = library.files.get(name)
    if path is None:
        raise HTTPException(404, "There is no such page in the documentation.")
    if not is_document(path.name):
        return FileResponse(path)
    document = await asyncio.to_thread(library.document, name)
    return await _page(request, "document.html", document=document)


async def search(request: Request) -> Response:
    """Show the sections that have all words of a query."""
    query = request.query_params.get("q", "")[:200]
    hits = await asyncio.to_thread(get_library(request).search, query)
    return await _page(request, "document_search.html", query=query, found=hits, max_found=MAX_FOUND)


async def _page(request: Request, template: str, **values: Any) -> Response:
    viewer = await get_viewer(request)
    chapters = get_library(request).chapters
    return page(request, template, viewer=viewer, section=ADDRESS, chapters=chapters, **{"query": "", **values})
