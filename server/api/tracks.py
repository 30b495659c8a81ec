"""Routes that anybody may read: tracks and leaderboards."""

from dataclasses import replace
from datetime import date
from typing import Annotated, Any

from fastapi import APIRouter, Depends, Query, Request, Response

from ..leaderboards.board_cache import PAGE_ENTRIES, MadeBoard
from ..leaderboards.reading import (
    MAX_TEXT,
    BoardSearch,
    ShownRows,
    shown_leaderboard,
    shown_log_boards,
    shown_rank_history,
)
from ..tracks import load_known_track, track_file, track_view, track_views
from ..views.leaderboards import LeaderboardView, LogBoardsView, TeamRanksView
from ..views.tracks import TrackListView, TrackView
from .access import MAX_NUMBER, ServicesOf, VisitorOf
from .conditional import answer
from .problems import RESPONSES

MAX_PAGE_ENTRIES = 500

router = APIRouter(tags=["tracks"], responses=RESPONSES)

Stage = Annotated[str | None, Query(description="Name of the stage; by default the one that opened last.")]
After = Annotated[int, Query(ge=0, le=MAX_NUMBER, description="`next_after` from the previous page.")]
Limit = Annotated[int, Query(ge=1, le=MAX_PAGE_ENTRIES, description="Number of entries.")]


def search_entries(
    q: Annotated[str, Query(max_length=MAX_TEXT, description="Only teams with this in their name.")] = "",
    since: Annotated[date | None, Query(description="Only what was submitted on this day (UTC) or later.")] = None,
    until: Annotated[date | None, Query(description="Only what was submitted on this day (UTC) or earlier.")] = None,
) -> BoardSearch:
    """Return what the query of a board searches for; ranks stay those of the whole board."""
    return BoardSearch(team=q.strip(), since=since, until=until)


EntrySearch = Annotated[BoardSearch, Depends(search_entries)]
UNCHANGED: dict[int | str, dict[str, Any]] = {
    304: {"description": "The client has this revision already (`If-None-Match`)."}
}


@router.get("/tracks")
def list_tracks(services: ServicesOf) -> TrackListView:
    """Return all tracks with their tasks and limits."""
    return track_views(services.settings)


@router.get("/tracks/{track}")
def get_track(services: ServicesOf, track: str) -> TrackView:
    """Return one track."""
    return track_view(load_known_track(track), services.settings)


@router.get("/tracks/{track}/file")
def get_track_file(track: str) -> Response:
    """Return the file of a track as YAML text, with which its episodes can be played and its results audited."""
    return Response(track_file(track), media_type="application/yaml")


@router.get("/competitions/{competition}/leaderboards/{track}", response_model=LeaderboardView, responses=UNCHANGED)
@router.get("/leaderboards/{track}", response_model=LeaderboardView, responses=UNCHANGED)
def get_leaderboard(
    request: Request,
    services: ServicesOf,
    principal: VisitorOf,
    track: str,
    *,
    competition: str | None = None,
    task: Annotated[str | None, Query(description="Rank by this task alone; by default by all tasks together.")] = None,
    stage: Stage = None,
    searched: EntrySearch,
    rows: Annotated[ShownRows, Query(description="Entries of teams, baselines, or both.")] = ShownRows.ALL,
    after: After = 0,
    limit: Limit = PAGE_ENTRIES,
) -> Response:
    """Return a page of the standings of a track or of one of its tasks: the best completed evaluation of each team."""
    search = replace(searched, rows=rows)
    with services.database.reading() as session:
        board = shown_leaderboard(session, principal, track, task=task, stage=stage, competition=competition)
    return _answer(request, board if search.is_empty else MadeBoard(view=search.apply(board.view)), after, limit)


@router.get("/competitions/{competition}/leaderboards/{track}/ranks")
@router.get("/leaderboards/{track}/ranks")
def get_rank_history(
    services: ServicesOf,
    principal: VisitorOf,
    track: str,
    *,
    competition: str | None = None,
    task: Annotated[str | None, Query(description="Of this task alone; of all tasks together without it.")] = None,
    stage: Stage = None,
) -> list[TeamRanksView]:
    """Return the ranks of a leaderboard's first teams over time."""
    with services.database.reading() as session:
        return shown_rank_history(session, principal, track, task=task, stage=stage, competition=competition)


@router.get("/competitions/{competition}/leaderboards/{track}/logs", response_model=LogBoardsView, responses=UNCHANGED)
@router.get("/leaderboards/{track}/logs", response_model=LogBoardsView, responses=UNCHANGED)
def get_log_boards(
    request: Request,
    services: ServicesOf,
    principal: VisitorOf,
    track: str,
    *,
    competition: str | None = None,
    stage: Stage = None,
    search: EntrySearch,
    after: After = 0,
    limit: Limit = PAGE_ENTRIES,
) -> Response:
    """Return a page of the verified logs of a track, ranked by task, and the 2025 text logs, which are not ranked."""
    with services.database.reading() as session:
        board = shown_log_boards(session, principal, track, stage=stage, competition=competition)
    return _answer(
        request, board if search.is_empty else MadeBoard(view=search.apply_to_logs(board.view)), after, limit
    )


def _answer(
    request: Request, board: MadeBoard[LeaderboardView] | MadeBoard[LogBoardsView], after: int, limit: int
) -> Response:
    return answer(
        request,
        board.body(after, limit),
        revision=board.view.revision,
        media_type="application/json",
        headers={"Cache-Control": "no-cache", "Vary": "Authorization"},
    )
