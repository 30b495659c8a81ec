"""The competition's home page: schedule, tracks, rules, prizes, commitments, winners."""

from __future__ import annotations

from datetime import UTC, datetime
from functools import partial
from typing import TYPE_CHECKING

from ...site import page, site_of, viewer_of
from ..addresses import board_address, competition_address, contest_in

if TYPE_CHECKING:
    from starlette.requests import Request
    from starlette.responses import Response

N_SAID = 3
"""Of the newest announcements on the page; all of them have a page of their own."""


async def competitions(request: Request) -> Response:
    """Show all competitions of this service to everybody."""
    found = await site_of(request).data.competitions()
    return page(request, "competitions.html", viewer=await viewer_of(request), section="/competition", found=found)


async def competition(request: Request) -> Response:
    """Show a competition to everybody: the one in the address, else the one that opened last.

    Raises:
        ServiceError: there is no such competition.
    """
    data, contest = site_of(request).data, contest_in(request)
    found, said = await data.competition(contest), await data.announcements()
    viewer = await viewer_of(request)
    return page(
        request,
        "contest.html",
        viewer=viewer,
        section="/competition",
        found=found,
        competition=competition_address(contest),
        board_address=partial(board_address, contest),
        has_others=len(await data.competitions()) > 1,
        said=said[:N_SAID],
        now=datetime.now(UTC),
    )
