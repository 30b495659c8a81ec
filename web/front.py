"""What the front page shows to everybody; made by `pages.home`, cached for some seconds by `site`."""

from collections.abc import Awaitable, Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from time import monotonic
from typing import Generic, TypeVar
from uuid import UUID

from vitac.evaluator.tracks import Track
from vitac.server.views.comparisons import PublicEpisodeView, StillView
from vitac.server.views.competition import CompetitionView
from vitac.server.views.correspondence import AnnouncementView
from vitac.server.views.leaderboards import LeaderboardEntryView


@dataclass(frozen=True, kw_only=True)
class TrackCard:
    """A track on the front page.

    Attributes:
        name: of the track.
        further: whether it is none of the challenge's own.
        title: of the track.
        summary: what it is about.
        picture: static file with one of its scenes; None where there is none.
        ranked: number of teams on its board.
        is_practice: whether the board is for practice.
        leader: the first one, if any.
        state: whether it takes submissions.
        moment: until when, or from when on; None outside of a competition.
    """

    name: str
    further: bool
    title: str
    summary: str
    picture: str | None
    ranked: int
    is_practice: bool
    leader: LeaderboardEntryView | None
    state: str
    moment: datetime | None


@dataclass(frozen=True, kw_only=True)
class FrontPage:
    """What the front page shows to everybody.

    Attributes:
        cards: the tracks.
        news: the newest entries of boards, with their tracks.
        stills: of episodes of their public submissions, by submission.
        ranks_before: ranks of their teams before them, by evaluation; teams that were on no board have none.
        running: number of evaluations that run now.
        waiting: number of evaluations in the queue.
        public: submissions among them that everybody may see.
        cup: the competition, if there is one.
        said: the newest announcements.
        episode: a public one with a playback; None: the shipped one is played.
    """

    cards: Sequence[TrackCard]
    news: Sequence[tuple[Track, LeaderboardEntryView]]
    stills: Mapping[UUID, StillView]
    ranks_before: Mapping[UUID, int]
    running: int
    waiting: int
    public: Collection[UUID]
    cup: CompetitionView | None
    said: Sequence[AnnouncementView]
    episode: PublicEpisodeView | None


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
        found = self._read
        if found is None or monotonic() - found[0] >= self._kept_s:
            found = (monotonic(), await read())
            self._read = found
        return found[1]
