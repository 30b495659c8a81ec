"""The page of a track's logs: verified ones by task, 2025 text logs beside their claims, each in pages of its own."""

from functools import partial

from starlette.requests import Request
from starlette.responses import Response
from vitac.server.contest.view import track_stages
from vitac.server.leaderboards.shown import shown_log_boards
from vitac.server.sharing.public_pages import public_among

from ..site import page, principal_of, site_of, viewer_of
from .addresses import board_address, board_data_address, competition_address, contest_in
from .contest.stages import find_stage_title, stage_tabs
from .paging import PAGE_ENTRIES, board_page
from .tracks import accepts_logs, board_query, contest_tabs, entry_rows, known_track, tabs, track_tabs

TEXT_LOGS = "text-logs"


async def logs(request: Request) -> Response:
    """Show the logs of a track, with `?stage=` of a stage, with `?q=` those of teams with that in their name."""
    track = known_track(request.path_params["track"])
    site, viewer = site_of(request), await viewer_of(request)
    stage, contest = request.query_params.get("stage"), contest_in(request)
    address = f"{board_address(contest, track.name)}/logs"
    paged = partial(
        board_page,
        request,
        f"{address}{board_query(None, stage)}",
        own_names=viewer.own_names if viewer else (),
    )
    found, stages, others = await site.read(
        lambda session: (
            shown_log_boards(session, principal_of(viewer), track.name, stage=stage, contest=contest).view,
            track_stages(session, track.name, contest),
            contest_tabs(session, contest, track.name, "/logs"),
        )
    )
    shown = {board.task: paged(board.entries, section=f"logs-{board.task}") for board in found.boards}
    text_logs = paged(found.text_logs, section=TEXT_LOGS)
    listed = [entry.submission_id for board in shown.values() for entry in board.entries]
    listed += [entry.submission_id for entry in text_logs.entries]
    public = await site.read(lambda session: public_among(session, listed))
    rows = partial(entry_rows, request, viewer, public)
    return page(
        request,
        "logs.html",
        viewer=viewer,
        section=f"/tracks/{track.name}",
        track=track,
        logs_address=address,
        competition=competition_address(contest),
        board_address=board_address(contest, track.name),
        board_data=board_data_address(contest, track.name),
        contest_tabs=others,
        track_tabs=track_tabs(site, track, "/logs", has_page=accepts_logs) if contest is None else (),
        tabs=tabs(track, None, logs=True, stage=stage, contest=contest),
        found=found,
        stage=stage,
        stage_title=find_stage_title(stages, found.stage),
        stage_tabs=stage_tabs(stages, found.stage, lambda other: f"{address}{board_query(None, other)}"),
        query=board_query(None, stage),
        search=text_logs.search,
        searchable=max(text_logs.total, *(board.total for board in shown.values())) > PAGE_ENTRIES,
        shown=shown,
        rows={
            task: rows("log_row.html", board.entries, of=lambda entry: (entry.rank, entry.copy_of))
            for task, board in shown.items()
        },
        text_logs=text_logs,
        text_log_rows=rows("text_log_row.html", text_logs.entries),
    )
