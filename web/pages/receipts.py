"""The page of the chain of receipts, for everybody, and the receipt of a submission as a file."""

from __future__ import annotations

from typing import TYPE_CHECKING

from starlette.responses import Response

from ..site import page, require_viewer, site_of, viewer_of
from .addresses import as_id

if TYPE_CHECKING:
    from starlette.requests import Request


async def receipts(request: Request) -> Response:
    """Show the public key, how long the chain is, its end, and how to check a receipt."""
    return page(
        request,
        "receipts.html",
        viewer=await viewer_of(request),
        section="/receipts",
        chain=await site_of(request).data.receipts(),
    )


async def receipt_file(request: Request) -> Response:
    """Return the receipt of a submission's newest result."""
    viewer = await require_viewer(request)
    found = await site_of(request).data.receipt(viewer.visitor, as_id(request.path_params["submission_id"]))
    name = f"receipt-{found.link.number}.json"
    return Response(
        found.model_dump_json(indent=1),
        media_type="application/json",
        headers={"Content-Disposition": f'attachment; filename="{name}"'},
    )
