"""The front page: what this is, an episode to play, competitions and tracks with their state, and recent results."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from uuid import UUID

from sqlalchemy.orm import Session
from starlette.requests import Request
from starlette.responses import Response
from vitac.evaluator.tracks import ListKind, find_task, load_track
from vitac.server.accounts import messages
from vitac.server.competitions.view import competition_list_view, competition_view, track_stages
from vitac.server.database.states import EvaluationState
from vitac.server.evaluations.progress import count_open
from vitac.server.leaderboards.baselines import list_baselines
from vitac.server.leaderboards.public_pages import public_among
from vitac.server.leaderboards.reading import shown_leaderboard, shown_rank_history
from vitac.server.playbacks.stills import find_stills, newest_public_episode
from vitac.server.principals import VISITOR
from vitac.server.tracks import is_challenge_track
from vitac.server.views.competition import (
    CompetitionState,
    CompetitionSummaryView,
    CompetitionTrackView,
    CompetitionView,
    StageView,
)
from vitac.server.views.leaderboards import DatedRankView, LeaderboardEntryView, LeaderboardView

from ..front import Challenge, CompetitionCard, FrontPage, News, TrackCard, TrackState
from ..rendering import STATIC
from ..site import Site, get_site, get_viewer, page
from .addresses import board_address, board_query, competition_address
from .competition import list_countdowns
from .episodes import player_script
from .tracks import find_scene

NEWS = 5
ANNOUNCEMENTS = 3
EXAMPLE = "example.scene"
"""The playback of an episode of peg insertion in which the peg goes straight to its hole."""


CHALLENGE = "peg-insertion"
"""The task that visitors are invited to play by hand."""

PICTURES = {"track_1": "lock-opening"}
"""Tasks whose pictures stand for their tracks, in place of those of their first tasks."""


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
    now, listed = datetime.now(UTC), competition_list_view(session).items
    cups = {one.name: competition_view(session, one.name) for one in listed}
    boards = {name: _read_boards(session, name, listed) for name in site.tracks}
    ranked = [
        (board, entry) for track in boards.values() for board in track for entry in board.view.entries if entry.rank
    ]
    newest = sorted(ranked, key=lambda new: new[1].evaluated_at, reverse=True)[:NEWS]
    public = public_among(session, [entry.submission_id for _, entry in newest])
    open_now = count_open(session)
    shown = [one for one in listed if one.state is not CompetitionState.FINAL] or listed[:1]
    return FrontPage(
        running=open_now[EvaluationState.RUNNING],
        waiting=open_now[EvaluationState.QUEUED],
        cards=[_card(name, boards[name], list(cups.values()), now) for name in site.tracks],
        news=_list_news(session, newest, cups),
        public=public,
        stills=find_stills(session, VISITOR, public),
        competitions=[
            CompetitionCard(
                address=competition_address(one.name if len(listed) > 1 else None),
                view=cups[one.name],
                state=one.state,
                countdowns=list_countdowns(cups[one.name], now),
                prize=sum(prize.amount * prize.winners for track in cups[one.name].tracks for prize in track.prizes),
            )
            for one in shown
        ],
        has_past=len(shown) < len(listed),
        said=messages.list_announcements(session)[:ANNOUNCEMENTS],
        episode=newest_public_episode(session, site.services.settings),
        challenge=_make_challenge(session, boards, several=len(cups) > 1),
    )


@dataclass(frozen=True, kw_only=True)
class _Board:
    """The board of a track in a stage; of the one that is shown first, `is_first`."""

    track: str
    competition: str | None
    stage: StageView | None
    view: LeaderboardView
    is_first: bool

    def address(self, *, several: bool, task: str | None = None) -> str:
        place = board_address(self.competition if several else None, self.track)
        return place + board_query(task, self.stage.name if self.stage and not self.is_first else None)


def _read_boards(session: Session, track: str, listed: Sequence[CompetitionSummaryView]) -> list[_Board]:
    """Return the boards of a track in all competitions that hold it, the stage that opened last first."""
    boards: list[_Board] = []
    names: list[str | None] = [one.name for one in listed if track in one.tracks]
    for competition in names or [None]:
        shown = shown_leaderboard(session, VISITOR, track, competition=competition).view
        stages = {stage.name: stage for stage in track_stages(session, track, competition)}
        opened = [name for name, stage in stages.items() if stage.opens <= datetime.now(UTC) and name != shown.stage]
        earlier = [
            shown_leaderboard(session, VISITOR, track, stage=name, competition=competition).view
            for name in reversed(opened)
        ]
        boards += [
            _Board(
                track=track,
                competition=competition,
                stage=stages.get(view.stage or ""),
                view=view,
                is_first=view is shown,
            )
            for view in (shown, *earlier)
        ]
    return boards


def _make_challenge(session: Session, boards: Mapping[str, Sequence[_Board]], *, several: bool) -> Challenge:
    """Return what a visitor who plays by hand is compared with, on the first board that shows baselines."""
    track, _ = find_task(CHALLENGE)
    shown = next((one for one in boards.get(track.name, ()) if one.view.list_kind is ListKind.PUBLIC), None)
    if shown is None:
        return Challenge(task=CHALLENGE, baseline=None, address="")
    best = list_baselines(session, track, CHALLENGE)[0]
    return Challenge(task=CHALLENGE, baseline=best, address=shown.address(several=several, task=CHALLENGE))


def _list_news(
    session: Session, newest: Sequence[tuple[_Board, LeaderboardEntryView]], cups: Mapping[str, CompetitionView]
) -> list[News]:
    """Return the newest entries with which rank each team had before."""
    histories: dict[tuple[str, str | None, str | None], Mapping[UUID, Sequence[DatedRankView]]] = {}

    def find_rank_before(board: _Board, entry: LeaderboardEntryView) -> int | None:
        key = (board.track, board.view.stage, board.competition)
        if key not in histories:
            teams = shown_rank_history(
                session, VISITOR, board.track, stage=board.view.stage, competition=board.competition
            )
            histories[key] = {team.submission_id: team.ranks for team in teams}
        ranks = histories[key].get(entry.submission_id, ())
        return ranks[-2].rank if len(ranks) > 1 else None

    return [
        News(
            track=load_track(board.track).title,
            picture=_find_picture(board.track, list(cups.values())),
            address=board.address(several=len(cups) > 1),
            competition=cups[board.competition].title if board.competition and len(cups) > 1 else None,
            entry=entry,
            rank_before=find_rank_before(board, entry),
        )
        for board, entry in newest
    ]


async def example(_: Request) -> Response:
    """Answer with the scene of the front page's episode."""
    return Response(
        (STATIC / EXAMPLE).read_bytes(),
        media_type="application/octet-stream",
        headers={"Content-Encoding": "gzip", "Cache-Control": "no-cache"},
    )


def _card(name: str, boards: Sequence[_Board], cups: Sequence[CompetitionView], now: datetime) -> TrackCard:
    track, first = load_track(name), boards[0]
    board = next((one for one in boards if any(entry.rank for entry in one.view.entries)), first)
    ranked = [entry for entry in board.view.entries if entry.rank]
    holding = [(cup, held) for cup in cups for held in cup.tracks if held.name == name]
    return TrackCard(
        name=name,
        further=not is_challenge_track(track),
        title=track.title,
        summary=track.summary,
        picture=_find_picture(name, cups),
        address=board.address(several=len(cups) > 1),
        ranked=len(ranked),
        is_practice=board.view.is_practice,
        stage=board.stage.title if board.stage and board is not first else None,
        leader=ranked[0] if ranked else None,
        states=[_find_state(held, cup.title if len(holding) > 1 else None, now) for cup, held in holding]
        or [TrackState(competition=None, sentence="Open for practice", moment=None)],
    )


def _find_picture(name: str, cups: Sequence[CompetitionView]) -> str:
    """Return the static file with a scene of a track: of the task that a competition names, else of its first one."""
    named = (track.picture for cup in cups for track in cup.tracks if track.name == name and track.picture)
    task = next(named, PICTURES.get(name))
    return find_scene(find_task(task)[1] if task else next(iter(load_track(name).tasks.values())))


def _find_state(track: CompetitionTrackView, competition: str | None, now: datetime) -> TrackState:
    """Return whether a track takes submissions, in words that a time follows."""
    open_stage = next((stage for stage in track.stages if stage.is_open), None)
    following = next((stage for stage in track.stages if stage.opens > now), None)
    if not track.taken_here:
        sentence, moment = "Submissions are collected elsewhere", None
    elif open_stage is not None:
        sentence, moment = f"{open_stage.title} is open until", open_stage.closes
    elif following is not None:
        sentence, moment = f"{following.title} opens on", following.opens
    else:
        sentence, moment = "Closed since", track.stages[-1].closes
    return TrackState(competition=competition, sentence=sentence, moment=moment)
