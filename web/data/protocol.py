"""What the pages need to know, as one protocol: `service_data` answers it, tests answer it with fixed values."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from collections.abc import Sequence
    from uuid import UUID

    from vitac.server.accounts.principals import Principal
    from vitac.server.views.leaderboards import LeaderboardView, LogBoardsView
    from vitac.server.views.logs import ActionMatchView
    from vitac.server.views.submissions import EpisodeView, SubmissionListView, SubmissionView


@dataclass(frozen=True, kw_only=True)
class Visitor:
    """Who holds a valid API token.

    Attributes:
        principal: who asks, for the service.
        token_id: row id of the token.
    """

    principal: Principal
    token_id: UUID

    @property
    def name(self) -> str:
        """The team's name, or what stands for an organizer."""
        return self.principal.team_name or "organizers"

    @property
    def is_organizer(self) -> bool:
        """Whether every team's submissions are shown."""
        return self.principal.is_organizer

    def may_see(self, team: str) -> bool:
        """Tell whether the submissions of a team are shown."""
        return self.is_organizer or self.name == team


@dataclass(frozen=True, kw_only=True)
class LimitRow:
    """One line of the limits table on the rules page."""

    title: str
    value: str


class PageData(Protocol):
    """Reads and the one write of the pages. What a visitor may not see raises the service's "not found"."""

    async def visitor_with_token(self, token: str) -> Visitor | None:
        """Return whose API token this is, or None where it is unknown, revoked or expired."""

    async def visitor_with_token_id(self, token_id: UUID) -> Visitor | None:
        """Return the holder of a token that signed in before, or None where it is no longer valid."""

    async def leaderboard(self, track: str, task: str | None) -> LeaderboardView:
        """Return the leaderboard of a track, or of one of its tasks."""

    async def log_boards(self, track: str) -> LogBoardsView:
        """Return the logs of a track, verified ones and those of 2025."""

    async def submission(self, visitor: Visitor, submission_id: UUID) -> SubmissionView:
        """Return one submission."""

    async def submissions(self, visitor: Visitor, before: UUID | None) -> SubmissionListView:
        """Return the visitor's submissions (all teams' for an organizer), those older than a cursor."""

    async def episodes(self, visitor: Visitor, submission_id: UUID) -> Sequence[EpisodeView]:
        """Return how the finished episodes of a submission's newest evaluation ended."""

    async def action_matches(self, visitor: Visitor, submission_id: UUID) -> Sequence[ActionMatchView]:
        """Return how far the team's models go along with a log; nothing for other submissions."""

    async def cancel(self, visitor: Visitor, submission_id: UUID) -> None:
        """Cancel the running or waiting evaluation of a submission."""

    def log_size(self) -> str:
        """Return how large a log may be, in words."""

    def limits(self) -> Sequence[LimitRow]:
        """Return the limits in force on this server."""
