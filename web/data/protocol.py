"""The data that the pages need, as one protocol: implemented by `service`, and by tests with fixed values."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol, TypeVar

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Callable, Collection, Sequence
    from contextlib import AbstractAsyncContextManager
    from datetime import datetime
    from uuid import UUID

    from sqlalchemy.orm import Session
    from vitac.evaluator.agent.description import SandboxDescription
    from vitac.evaluator.sensors.appearance import Appearance
    from vitac.server.playbacks.files import PlaybackFile
    from vitac.server.principals import Principal
    from vitac.server.queue.workers import Disk
    from vitac.server.receipts.receipt import Receipt
    from vitac.server.settings import Registration
    from vitac.server.submissions.upload import AnnouncedUpload
    from vitac.server.views.archive import ArchiveView
    from vitac.server.views.contest import CompetitionSummaryView, CompetitionView, StageView
    from vitac.server.views.leaderboards import LeaderboardView, LogBoardsView, PastResultView
    from vitac.server.views.logs import ActionMatchView
    from vitac.server.views.messages import AnnouncementView
    from vitac.server.views.operations import OperationsView
    from vitac.server.views.playbacks import PlaybackView, PublicEpisodeView, ShownEpisodeView
    from vitac.server.views.receipts import ChainView
    from vitac.server.views.submissions import (
        DocumentView,
        EpisodeView,
        OutputView,
        SensorView,
        SubmissionListView,
        SubmissionView,
    )

ResultT = TypeVar("ResultT")


@dataclass(frozen=True, kw_only=True)
class Visitor:
    """The holder of a valid API token.

    Attributes:
        principal: the token's team or organizer, for the service.
        token_id: row id of the token.
    """

    principal: Principal
    token_id: UUID

    @property
    def name(self) -> str:
        """The team's name, or the role in the plural."""
        return self.principal.team_name or f"{self.principal.role}s"

    @property
    def own_names(self) -> frozenset[str]:
        """The names under which the own team may be on boards."""
        return frozenset({self.name, self.principal.team_pseudonym or self.name})

    @property
    def is_organizer(self) -> bool:
        """Whether all teams' submissions are shown."""
        return self.principal.is_organizer

    @property
    def has_team(self) -> bool:
        """Whether there is a team page to show."""
        return self.principal.team_id is not None

    def may_see(self, team: str) -> bool:
        """Return whether the submissions of a team are shown."""
        return self.principal.reads_all_teams or team in self.own_names


@dataclass(frozen=True, kw_only=True)
class LimitRow:
    """One line of the limits table on the rules page."""

    title: str
    value: str


@dataclass(frozen=True, kw_only=True)
class ShownSensor:
    """What a page shows of the sensor of a submission.

    Attributes:
        submission_id: whose.
        name: of the submission.
        team: of the submission.
        view: mesh, document, gain and figures.
        looks: gel, quality and markers.
    """

    submission_id: UUID
    name: str
    team: str
    view: SensorView
    looks: Appearance


@dataclass(frozen=True, kw_only=True)
class SubmissionDetail:
    """What the page of a submission shows.

    Attributes:
        submission: with its newest evaluation.
        episodes: outcomes of the finished episodes of that evaluation.
        action_matches: how far the team's models go along with a log; nothing for other submissions.
        episodes_with_output: number of episodes with output, or in which the policy failed, that the visitor may see.
        past: what the team has reached in its tasks so far; nothing before the submission's own result.
    """

    submission: SubmissionView
    episodes: Sequence[EpisodeView]
    action_matches: Sequence[ActionMatchView]
    episodes_with_output: int
    past: Sequence[PastResultView]


@dataclass(frozen=True, kw_only=True)
class EpisodeAddress:
    """An episode of a submission's newest evaluation."""

    submission_id: UUID
    task: str
    number: int


@dataclass(frozen=True, kw_only=True)
class RegisteredTeam:
    """A team that has just registered, with the token that is shown this once."""

    team: str
    token: str
    token_id: UUID
    waits_for_approval: bool = False


@dataclass(frozen=True, kw_only=True)
class PasswordSignIn:
    """Who says to be a member of a team, from which address."""

    team: str
    member: str
    password: str
    address: str


class PageData(Protocol):
    """The pages' reads and writes. What a visitor may not see raises the service's "not found"."""

    async def ask(self, query: Callable[[Session], ResultT]) -> ResultT:
        """Return what a function of the service layer gives, in one transaction and in a thread."""

    async def note_registration(self, address: str) -> None:
        """Count a try to register or to join a team from an address; one too many raises the service's refusal."""

    async def visitor_with_token(self, token: str) -> Visitor | None:
        """Return the holder of an API token, or None if it is unknown, revoked or expired."""

    async def visitor_with_password(self, given: PasswordSignIn) -> Visitor | None:
        """Begin a session and return who signed in, or None if nobody has this password; too many tries are refused."""

    async def end_session(self, visitor: Visitor) -> None:
        """End the session of a browser that signed in with a password; a token stays good."""

    async def visitor_with_token_id(self, token_id: UUID) -> Visitor | None:
        """Return the holder of a token that signed in before, or None if it is no longer valid."""

    def registration(self) -> Registration:
        """Return who may register a team."""

    async def teams_locked_since(self) -> datetime | None:
        """Return the competition's lock date if it is over: only organizers change teams now."""

    async def register(self, *, name: str, contact: str, invite: str, address: str) -> RegisteredTeam:
        """Register a team from a client's address; what cannot be accepted raises the service's refusal."""

    async def leaderboard(
        self,
        track: str,
        task: str | None,
        stage: str | None = None,
        *,
        contest: str | None = None,
        visitor: Visitor | None = None,
    ) -> LeaderboardView:
        """Return the leaderboard of a track, or of one of its tasks; `stage` None is the stage that opened last.

        Args:
            track: name.
            task: name; None: all tasks together.
            stage: name.
            contest: name of the competition; None: the one that opened last.
            visitor: who sees it: organizers all results also while boards are frozen.
        """

    async def competitions(self) -> Sequence[CompetitionSummaryView]:
        """Return the competitions of this service, the one that opened last first."""

    async def competitions_to_choose_from(self) -> Sequence[CompetitionSummaryView]:
        """Return the competitions between which an upload has to choose; empty where no track has several now."""

    async def competition(self, name: str | None = None) -> CompetitionView:
        """Return the competition of this service; where there is none, the service's refusal is raised."""

    async def stages(self, track: str, contest: str | None = None) -> Sequence[StageView]:
        """Return the stages of a track; empty where it is in no competition."""

    async def archive(self, name: str | None = None) -> ArchiveView:
        """Return the archive of a competition that is final; else the service's refusal is raised."""

    async def log_boards(
        self, track: str, stage: str | None = None, *, contest: str | None = None, visitor: Visitor | None = None
    ) -> LogBoardsView:
        """Return the verified logs and the 2025 text logs of a track; the arguments are those of `leaderboard`."""

    async def submission(self, visitor: Visitor | None, submission_id: UUID) -> SubmissionDetail:
        """Return one submission with its episodes; for None only a public one, else a token is asked for."""

    async def public_among(self, submissions: Collection[UUID]) -> Collection[UUID]:
        """Return those of some submissions that everybody may see."""

    async def set_public(self, visitor: Visitor, submission_id: UUID, *, public: bool) -> None:
        """Let everybody see the result of a submission, or its team only."""

    async def submissions(self, visitor: Visitor, before: UUID | None, track: str | None = None) -> SubmissionListView:
        """Return the visitor's submissions (all teams' for an organizer) older than a cursor, of a track or all."""

    async def output(self, visitor: Visitor, submission_id: UUID, task: str | None, after: int) -> OutputView:
        """Return what a submission's policy printed in the episodes after one; what is not shown is refused."""

    async def receipts(self) -> ChainView:
        """Return key, length and end of the chain of receipts, without its links."""

    async def receipt(self, visitor: Visitor, submission_id: UUID) -> Receipt:
        """Return the receipt of a submission's newest result; without one the service's refusal is raised."""

    async def episode(self, visitor: Visitor | None, place: EpisodeAddress) -> ShownEpisodeView:
        """Return a finished episode and how far its playback is."""

    async def public_episode(self) -> PublicEpisodeView | None:
        """Return the episode of a public submission whose playback was asked for last and is made; None without one."""

    async def announcements(self) -> Sequence[AnnouncementView]:
        """Return what the organizers say to everybody, newest first."""

    async def ask_for_playback(self, visitor: Visitor | None, place: EpisodeAddress, address: str) -> PlaybackView:
        """Have the playback of an episode made for a client's address; one too many raises the service's refusal."""

    async def playback_file(self, visitor: Visitor | None, place: EpisodeAddress, file: PlaybackFile) -> bytes:
        """Return a file of an episode's playback."""

    async def sensor(self, visitor: Visitor, submission_id: UUID) -> ShownSensor:
        """Return the sensor of a submission."""

    async def design_document(self, visitor: Visitor, submission_id: UUID) -> tuple[DocumentView, bytes]:
        """Return the design document of a submission, as the team brought it."""

    async def cancel(self, visitor: Visitor, submission_id: UUID) -> None:
        """Cancel the queued or running evaluation of a submission."""

    async def operations(self) -> OperationsView:
        """Return the state of the service, for organizers."""

    async def sandboxes(self) -> Sequence[SandboxDescription]:
        """Return what policies find in the sandboxes of the workers; nothing before the first worker has started."""

    def server_disk(self) -> Disk:
        """Return the disk of this server's state directory."""

    def event_stream(self, visitor: Visitor) -> AbstractAsyncContextManager[None]:
        """Count an event stream while the block runs; one too many raises the service's refusal."""

    async def upload(self, visitor: Visitor, announced: AnnouncedUpload, body: AsyncIterator[bytes]) -> UUID:
        """Make a submission out of a body that arrives; what cannot be accepted raises the service's refusal."""

    def archive_size(self) -> str:
        """Return the largest size of an archive, as text."""

    def log_size(self) -> str:
        """Return the largest size of a log, as text."""

    def limits(self) -> Sequence[LimitRow]:
        """Return the limits in force on this server."""
