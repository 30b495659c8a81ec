"""The front page: what this is, an episode to play, what happened recently, and the tracks with their state."""

from collections.abc import Sequence
from datetime import UTC, datetime
from uuid import UUID

from sqlalchemy.orm import Session
from starlette.requests import Request
from starlette.responses import Response
from vitac.evaluator.tracks import Track, load_track
from vitac.server.accounts import messages
from vitac.server.competitions.view import competition_view
from vitac.server.database.states import EvaluationState
from vitac.server.errors import ProblemCode, ServiceError
from vitac.server.evaluations.progress import count_open
from vitac.server.leaderboards.public_pages import public_among
from vitac.server.leaderboards.reading import shown_leaderboard, shown_rank_history
from vitac.server.playbacks.stills import find_stills, newest_public_episode
from vitac.server.principals import VISITOR
from vitac.server.tracks import is_challenge_track
from vitac.server.views.competition import CompetitionView
from vitac.server.views.leaderboards import LeaderboardEntryView, LeaderboardView

from ..front import FrontPage, TrackCard
from ..rendering import STATIC
from ..site import Site, get_site, get_viewer, page
from .episodes.page import player_script

NEWS = 5
ANNOUNCEMENTS = 3
EXAMPLE = "example.scene"
"""The playback of an episode of peg insertion in which the peg goes straight to its hole."""


PICTURES = {"track_1": "lock-opening.webp", "track_2": "fusion-insertion.webp", "track_3": "sensor-standard.webp"}
"""Stills of the challenge's tracks: the end of an episode as `envs/playback_files/still.py` draws it."""


async def home(request: Request) -> Response:
    """Show the front page; the player is loaded when somebody wants to play."""
    site = get_site(request)
    return page(
        request,
        "home.html",
        viewer=await get_viewer(request),
        section="/",
        front=await site.front.get(lambda: site.read(lambda session: _front(session, site))),
        first_track=site.tracks[0],
        player_script=player_script(),
    )


def _front(session: Session, site: Site) -> FrontPage:
    boards = {name: shown_leaderboard(session, VISITOR, name).view for name in site.tracks}
    cup = _competition(session)
    ranked = [(load_track(name), entry) for name, board in boards.items() for entry in board.entries if entry.rank]
    news = sorted(ranked, key=lambda new: new[1].evaluated_at, reverse=True)[:NEWS]
    public = public_among(session, [entry.submission_id for _, entry in news])
    open_now = count_open(session)
    return FrontPage(
        ranks_before=_find_ranks_before(session, news),
        running=open_now[EvaluationState.RUNNING],
        waiting=open_now[EvaluationState.QUEUED],
        cards=[_card(name, board, cup) for name, board in boards.items()],
        news=news,
        public=public,
        stills=find_stills(session, VISITOR, public),
        cup=cup,
        said=messages.list_announcements(session)[:ANNOUNCEMENTS],
        episode=newest_public_episode(session, site.services.settings),
    )


def _find_ranks_before(session: Session, news: Sequence[tuple[Track, LeaderboardEntryView]]) -> dict[UUID, int]:
    """Return which rank each team had before its new entry, by the entry's evaluation."""
    histories = {track.name: shown_rank_history(session, VISITOR, track.name) for track, _ in news}
    ranks = {(name, team.submission_id): team.ranks for name, teams in histories.items() for team in teams}
    before = {entry.evaluation_id: ranks.get((track.name, entry.submission_id), ()) for track, entry in news}
    return {evaluation: found[-2].rank for evaluation, found in before.items() if len(found) > 1}


async def example(_: Request) -> Response:
    """Answer with the scene of the front page's episode."""
    return Response(
        (STATIC / EXAMPLE).read_bytes(),
        media_type="application/octet-stream",
        headers={"Content-Encoding": "gzip", "Cache-Control": "no-cache"},
    )


def _competition(session: Session) -> CompetitionView | None:
    try:
        return competition_view(session)
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
        further=not is_challenge_track(track),
        title=track.title,
        summary=track.summary,
        picture=PICTURES.get(name),
        ranked=len(ranked),
        is_practice=board.is_practice,
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
