"""What the front page shows to everybody; made by `pages.home`, cached for some seconds by `site`."""

from collections.abc import Awaitable, Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from time import monotonic
from typing import Generic, TypeVar
from uuid import UUID

from vitac.server.views.comparisons import PublicEpisodeView, StillView
from vitac.server.views.competition import CompetitionState, CompetitionView
from vitac.server.views.correspondence import AnnouncementView
from vitac.server.views.leaderboards import BaselineView, LeaderboardEntryView


@dataclass(frozen=True, kw_only=True)
class TrackCard:
    """A track on the front page.

    Attributes:
        name: of the track.
        further: whether it is none of the challenge's own.
        title: of the track.
        summary: what it is about.
        picture: static file with one of its scenes.
        address: of its board.
        ranked: number of teams on it.
        is_practice: whether the board is for practice.
        stage: title of an earlier stage, whose board it is because that of the present one is empty; None: it is not.
        leader: the first one, if any.
        states: whether it takes submissions, in each competition that holds it.
    """

    name: str
    further: bool
    title: str
    summary: str
    picture: str
    address: str
    ranked: int
    is_practice: bool
    stage: str | None
    leader: LeaderboardEntryView | None
    states: Sequence["TrackState"]


@dataclass(frozen=True, kw_only=True)
class TrackState:
    """Whether a track takes submissions.

    Attributes:
        competition: title of the competition; None where there is a single one, or none.
        sentence: what is so.
        moment: until when, or from when on; None outside of a competition.
    """

    competition: str | None
    sentence: str
    moment: datetime | None


@dataclass(frozen=True, kw_only=True)
class Countdown:
    """What opens or closes next on some tracks, and when."""

    tracks: tuple[str, ...]
    stage: str
    closes: bool
    moment: datetime


@dataclass(frozen=True, kw_only=True)
class CompetitionCard:
    """A competition on the front page.

    Attributes:
        address: of its page.
        view: what its page shows.
        state: how far it is.
        countdowns: what opens or closes next.
        prize: sum of all its prizes, in its currency.
    """

    address: str
    view: CompetitionView
    state: CompetitionState
    countdowns: Sequence[Countdown]
    prize: int


@dataclass(frozen=True, kw_only=True)
class News:
    """A new entry of a board.

    Attributes:
        track: title of the track.
        picture: what stands in place of a still of an episode.
        address: of the board.
        competition: title of the competition; None where there is a single one, or none.
        rank_before: rank of its team before it; None where that was on no board.
    """

    track: str
    picture: str
    address: str
    competition: str | None
    entry: LeaderboardEntryView
    rank_before: int | None


@dataclass(frozen=True, kw_only=True)
class Challenge:
    """What a visitor who plays by hand is compared with.

    Attributes:
        task: that is played.
        baseline: the best one of the task's board; None where no board here shows any.
        address: of that board; empty without one.
    """

    task: str
    baseline: BaselineView | None
    address: str


@dataclass(frozen=True, kw_only=True)
class FrontPage:
    """What the front page shows to everybody.

    Attributes:
        cards: the tracks.
        news: the newest entries of boards.
        stills: of episodes of their public submissions, by submission.
        running: number of evaluations that run now.
        waiting: number of evaluations in the queue.
        public: submissions among them that everybody may see.
        competitions: those that are not final; the last one where all are.
        has_past: whether the page of all competitions has more.
        said: the newest announcements.
        episode: a public one with a playback; None: the shipped one is played.
        challenge: what visitors are invited to play by hand.
    """

    cards: Sequence[TrackCard]
    news: Sequence[News]
    stills: Mapping[UUID, StillView]
    running: int
    waiting: int
    public: Collection[UUID]
    competitions: Sequence[CompetitionCard]
    has_past: bool
    said: Sequence[AnnouncementView]
    episode: PublicEpisodeView | None
    challenge: Challenge


ValueT = TypeVar("ValueT")


class Recent(Generic[ValueT]):
    """The value as it was read last.

    Args:
        kept_s: after this time it is read again, perhaps by several requests at once [s].
    """

    def __init__(self, *, kept_s: float) -> None:
        self._kept_s = kept_s
        self._read: tuple[float, ValueT] | None = None

    async def get(self, read: Callable[[], Awaitable[ValueT]]) -> ValueT:
        """Return the value of the last reading, or read it."""
        kept = self._read
        if kept is None or monotonic() - kept[0] >= self._kept_s:
            kept = (monotonic(), await read())
            self._read = kept
        return kept[1]
