"""The page of a track's logs: verified ones by task, 2025 text logs beside their claims, each in pages of its own."""

from functools import partial
from typing import Any

from sqlalchemy.orm import Session
from starlette.requests import Request
from starlette.responses import Response
from vitac.server.leaderboards.public_pages import public_among
from vitac.server.leaderboards.reading import shown_log_boards

from ...site import get_principal, get_site, get_viewer, page
from ..addresses import AskedBoard, board_address
from .paging import board_page
from .tabs import known_track, read_surroundings

TEXT_LOGS = "text-logs"


async def logs(request: Request) -> Response:
    """Show the logs of a track, with `?stage=` of a stage, with `?q=` those of teams with that in their name."""
    asked, site, viewer = AskedBoard.read(request, logs=True), get_site(request), await get_viewer(request)
    track = known_track(asked.track)
    by, own_names = get_principal(viewer), viewer.own_names if viewer else frozenset()
    paged = partial(board_page, request, asked.address(), own_names=own_names)

    def read(session: Session) -> dict[str, Any]:
        found = shown_log_boards(session, by, track.name, stage=asked.stage, competition=asked.competition).view
        shown = {board.task: paged(board.entries, section=f"logs-{board.task}") for board in found.boards}
        text_logs = paged(found.text_logs, section=TEXT_LOGS)
        listed = [entry.submission_id for board in shown.values() for entry in board.entries]
        listed += [entry.submission_id for entry in text_logs.entries]
        around = read_surroundings(session, site, track, asked, shown_stage=found.stage)
        public = public_among(session, listed)
        return {"found": found, "shown": shown, "text_logs": text_logs, "public": public, **around}

    values = await site.read(read)
    boards = (values["text_logs"], *values["shown"].values())
    return page(
        request,
        "logs.html",
        viewer=viewer,
        own_names=own_names,
        logs_address=board_address(asked.competition, track.name) + asked.part,
        search=values["text_logs"].search,
        searchable=any(board.total > board.size for board in boards),
        **values,
    )
