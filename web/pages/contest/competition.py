"""The competition's home page: schedule, tracks, rules, prizes, commitments, winners."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ...site import page, site_of, viewer_of

if TYPE_CHECKING:
    from starlette.requests import Request
    from starlette.responses import Response


async def competition(request: Request) -> Response:
    """Show the competition to everybody.

    Raises:
        ServiceError: this service runs none.
    """
    found = await site_of(request).data.competition()
    return page(request, "competition.html", viewer=await viewer_of(request), section="/competition", found=found)
