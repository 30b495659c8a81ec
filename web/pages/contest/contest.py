"""The competition's home page: schedule, tracks, rules, prizes, commitments, winners."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import TYPE_CHECKING

from ...site import page, site_of, viewer_of

if TYPE_CHECKING:
    from starlette.requests import Request
    from starlette.responses import Response

N_SAID = 3
"""Of the newest announcements on the page; all of them have a page of their own."""


async def competition(request: Request) -> Response:
    """Show the competition to everybody.

    Raises:
        ServiceError: this service runs none.
    """
    data = site_of(request).data
    found, said = await data.competition(), await data.announcements()
    viewer = await viewer_of(request)
    return page(
        request,
        "contest.html",
        viewer=viewer,
        section="/competition",
        found=found,
        said=said[:N_SAID],
        now=datetime.now(UTC),
    )
