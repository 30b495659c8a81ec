"""Shows the documentation at `/docs/`, and searches it."""

import asyncio
from typing import Any, cast

from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import FileResponse, Response

from ..documentation.library import ADDRESS, INDEX, MAX_FOUND, Library, is_document
from ..site import get_viewer, page


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
    found = await asyncio.to_thread(get_library(request).search, query)
    return await _page(request, "document_search.html", query=query, found=found, max_found=MAX_FOUND)


async def _page(request: Request, template: str, **values: Any) -> Response:
    viewer = await get_viewer(request)
    chapters = get_library(request).chapters
    return page(request, template, viewer=viewer, section=ADDRESS, chapters=chapters, **{"query": "", **values})
