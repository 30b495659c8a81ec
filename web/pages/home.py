"""The front page: what this is, an episode to play, what happened lately, and the tracks with their state."""

from __future__ import annotations

from datetime import UTC, datetime
from functools import partial
from typing import TYPE_CHECKING

from starlette.responses import Response
from vitac.evaluator.tracks import load_track
from vitac.server.errors import ProblemCode, ServiceError

from ..data.front import Front, TrackCard
from ..rendering import STATIC
from ..site import page, site_of, viewer_of
from .episodes.page import player_script

if TYPE_CHECKING:
    from starlette.requests import Request
    from vitac.server.views.contest import CompetitionView
    from vitac.server.views.leaderboards import LeaderboardView

    from ..site import Site

NEWS = 5
ANNOUNCEMENTS = 3
EXAMPLE = "example.scene"
"""The playback of an episode of peg insertion in which the peg goes straight to its hole."""


async def home(request: Request) -> Response:
    """Show the front page; the player is loaded when somebody wants to play."""
    site = site_of(request)
    return page(
        request,
        "home.html",
        viewer=await viewer_of(request),
        section="/",
        front=await site.front.get(partial(_front, site)),
        first_track=site.tracks[0],
        player_script=player_script(),
    )


async def _front(site: Site) -> Front:
    boards = {name: await site.data.leaderboard(name, None) for name in site.tracks}
    cup = await _competition(site)
    ranked = [(load_track(name), entry) for name, board in boards.items() for entry in board.entries if entry.rank]
    news = sorted(ranked, key=lambda new: new[1].evaluated_at, reverse=True)[:NEWS]
    return Front(
        cards=[_card(name, board, cup) for name, board in boards.items()],
        news=news,
        public=await site.data.public_among([entry.submission_id for _, entry in news]),
        cup=cup,
        said=(await site.data.announcements())[:ANNOUNCEMENTS],
        episode=await site.data.public_episode(),
    )


async def example(_: Request) -> Response:
    """Answer with the scene of the front page's episode."""
    return Response(
        (STATIC / EXAMPLE).read_bytes(),
        media_type="application/octet-stream",
        headers={"Content-Encoding": "gzip", "Cache-Control": "no-cache"},
    )


async def _competition(site: Site) -> CompetitionView | None:
    try:
        return await site.data.competition()
    except ServiceError as error:
        if error.code is ProblemCode.NOT_FOUND:
            return None
        raise


def _card(name: str, board: LeaderboardView, cup: CompetitionView | None) -> TrackCard:
    track = load_track(name)
    ranked = [entry for entry in board.entries if entry.rank]
    state, moment = _state(name, cup)
    return TrackCard(
        name=name,
        title=track.title,
        summary=track.summary,
        ranked=len(ranked),
        leader=ranked[0] if ranked else None,
        state=state,
        moment=moment,
    )


def _state(name: str, cup: CompetitionView | None) -> tuple[str, datetime | None]:
    """Return whether a track takes submissions, in words that a time follows."""
    found = next((track for track in cup.tracks if track.name == name), None) if cup else None
    if found is None:
        return "Open for practice", None
    if not found.taken_here:
        return "Submissions are collected elsewhere", None
    open_stage = next((stage for stage in found.stages if stage.is_open), None)
    if open_stage is not None:
        return f"{open_stage.title} is open until", open_stage.closes
    now = datetime.now(UTC)
    following = next((stage for stage in found.stages if stage.opens > now), None)
    if following is not None:
        return f"{following.title} opens on", following.opens
    return "Closed since", found.stages[-1].closes
