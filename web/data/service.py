"""Reads the pages' data from the service layer; its calls block, so each runs in a thread.

Made by `application`.
"""

from __future__ import annotations

import asyncio
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import TYPE_CHECKING, TypeVar

from pydantic import ValidationError
from vitac.evaluator.sensors.appearance import appearance
from vitac.evaluator.sensors.made import read_made_sensor
from vitac.server import tokens
from vitac.server.api.teams import NewTeam
from vitac.server.contest.contest import Contest, contests_to_choose_from
from vitac.server.contest.view import competition_list_view, competition_view, track_stages
from vitac.server.errors import ProblemCode, ServiceError
from vitac.server.evaluations.history import histories
from vitac.server.leaderboards import history, log_boards, standings
from vitac.server.limiter import UPLOADS
from vitac.server.logs import action_matches
from vitac.server.members import members, registration
from vitac.server.messages import announcements
from vitac.server.metrics.totals import totals
from vitac.server.operations.state import operations
from vitac.server.playbacks import asking, files, recent
from vitac.server.principals import VISITOR
from vitac.server.publishing.archive import archive_view
from vitac.server.queue import workers
from vitac.server.queue.workers import disk_of
from vitac.server.sharing import public_pages
from vitac.server.sharing.public_pages import readable
from vitac.server.submissions import listing, output, receipts, runs, sensors, upload
from vitac.server.submissions.view import submission_views
from vitac.server.teams import teams
from vitac.server.visibility import visible

from ..session.signer import LIFETIME
from .limits import limit_rows, size
from .protocol import RegisteredTeam, ShownSensor, SubmissionDetail, Visitor

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Awaitable, Callable, Collection, Sequence
    from contextlib import AbstractAsyncContextManager, AbstractContextManager
    from uuid import UUID

    from sqlalchemy.orm import Session
    from vitac.evaluator.agent.description import SandboxDescription
    from vitac.server.api.streams import OpenStreams
    from vitac.server.db.engine import Database
    from vitac.server.limiter import ConcurrencyLimiter, SignInLimiters, WindowLimiter
    from vitac.server.playbacks.files import PlaybackFile
    from vitac.server.principals import Principal
    from vitac.server.queue.workers import Disk
    from vitac.server.receipts.receipt import Receipt
    from vitac.server.settings import Registration, Settings
    from vitac.server.storage.blobs import BlobStore
    from vitac.server.submissions.upload import AnnouncedUpload
    from vitac.server.views.archive import ArchiveView
    from vitac.server.views.contest import CompetitionSummaryView, CompetitionView, StageView
    from vitac.server.views.leaderboards import LeaderboardView, LogBoardsView
    from vitac.server.views.messages import AnnouncementView
    from vitac.server.views.operations import OperationsView
    from vitac.server.views.playbacks import PlaybackView, PublicEpisodeView, ShownEpisodeView
    from vitac.server.views.receipts import ChainView
    from vitac.server.views.submissions import DocumentView, OutputView, SensorView, SubmissionListView

    from .protocol import EpisodeAddress, LimitRow, PasswordSignIn

ResultT = TypeVar("ResultT")


@dataclass(frozen=True, kw_only=True)
class ServiceData:
    """The service as the pages see it; implements `PageData`."""

    database: Database
    settings: Settings
    blobs: BlobStore
    streams: OpenStreams
    registrations: WindowLimiter
    sign_ins: SignInLimiters
    playbacks: WindowLimiter
    uploads: ConcurrencyLimiter

    async def visitor_with_token(self, token: str) -> Visitor | None:
        """Return the holder of an API token."""
        return await self._visitor(self.read(lambda session: tokens.authenticate(session, token)))

    async def visitor_with_password(self, given: PasswordSignIn) -> Visitor | None:
        """Begin a session for who signed in."""
        member_key = f"{teams.name_key(given.team)}\n{teams.name_key(given.member)}"
        await asyncio.to_thread(self.sign_ins.note, given.address, member_key)

        def begun(session: Session) -> Principal:
            made = members.sign_in(session, given.team, given.member, given.password, LIFETIME)
            return tokens.principal_of_token_id(session, made.id)

        return await self._visitor(self.ask(begun))

    async def end_session(self, visitor: Visitor) -> None:
        """End the session of a browser that signed in with a password."""

        def ended(session: Session) -> None:
            if tokens.is_session(session, visitor.token_id):
                tokens.revoke(session, visitor.principal, visitor.token_id)

        await self.ask(ended)

    async def visitor_with_token_id(self, token_id: UUID) -> Visitor | None:
        """Return the holder of a token that signed in before."""
        return await self._visitor(self.read(lambda session: tokens.principal_of_token_id(session, token_id)))

    def registration(self) -> Registration:
        """Return who may register a team."""
        return self.settings.registration

    async def teams_locked_since(self) -> datetime | None:
        """Return the competition's lock date if it is over."""
        return await self.ask(teams.locked_since)

    async def register(self, *, name: str, contact: str, invite: str, address: str) -> RegisteredTeam:
        """Register a team."""
        try:
            new = NewTeam(name=name, contact=contact or None, invite=invite or None)
        except ValidationError as error:
            problems = " ".join(f"{problem['loc'][0]}: {problem['msg']}." for problem in error.errors())
            raise ServiceError(ProblemCode.INVALID_REQUEST, problems) from error
        await self.note_registration(address)

        def made(session: Session) -> RegisteredTeam:
            asked = registration.NewTeam(**new.model_dump())
            team, issued = registration.register(session, self.settings, None, asked)
            return RegisteredTeam(
                team=team.name,
                token=issued.secret,
                token_id=issued.token.id,
                waits_for_approval=team.approved_at is None,
            )

        return await self.ask(made)

    async def note_registration(self, address: str) -> None:
        """Count a try to register or to join a team."""
        await asyncio.to_thread(self.registrations.note, address, "registrations from one address")

    async def leaderboard(
        self,
        track: str,
        task: str | None,
        stage: str | None = None,
        *,
        contest: str | None = None,
        visitor: Visitor | None = None,
    ) -> LeaderboardView:
        """Return the leaderboard of a track, or of one of its tasks; `stage` None is the stage that opened last."""

        def read(session: Session) -> LeaderboardView:
            shown = Contest.find_by_track(session, track, contest).shown_stage(track, stage)
            unfrozen = _principal(visitor).organizes(shown.contest)
            return standings.leaderboard(session, shown, task=task, unfrozen=unfrozen).view

        return await self.read(read)

    async def competitions(self) -> Sequence[CompetitionSummaryView]:
        """Return the competitions of this service."""
        return (await self.read(competition_list_view)).items

    async def competitions_to_choose_from(self) -> Sequence[CompetitionSummaryView]:
        """Return the competitions between which an upload has to choose."""

        def choices(session: Session) -> Sequence[CompetitionSummaryView]:
            names = {one.name for one in contests_to_choose_from(session, datetime.now(UTC))}
            return [one for one in competition_list_view(session).items if one.name in names]

        return await self.read(choices)

    async def competition(self, name: str | None = None) -> CompetitionView:
        """Return a competition of this service."""
        return await self.read(lambda session: competition_view(session, name))

    async def stages(self, track: str, contest: str | None = None) -> Sequence[StageView]:
        """Return the stages of a track."""
        return await self.read(lambda session: track_stages(session, track, contest))

    async def archive(self, name: str | None = None) -> ArchiveView:
        """Return the archive of a competition."""
        return await self.ask(lambda session: archive_view(session, name))

    async def log_boards(
        self, track: str, stage: str | None = None, *, contest: str | None = None, visitor: Visitor | None = None
    ) -> LogBoardsView:
        """Return the logs of a track."""

        def read(session: Session) -> LogBoardsView:
            shown = Contest.find_by_track(session, track, contest).shown_stage(track, stage)
            unfrozen = _principal(visitor).organizes(shown.contest)
            return log_boards.log_boards(session, shown, unfrozen=unfrozen).view

        return await self.read(read)

    async def submission(self, visitor: Visitor | None, submission_id: UUID) -> SubmissionDetail:
        """Return one submission with its episodes."""
        by = _principal(visitor)

        def detail(session: Session) -> SubmissionDetail:
            found = readable(session, by, submission_id)
            evaluations = histories(session, [found], with_output=True)
            shown, is_own = evaluations[submission_id][0], by.may_see(found.team_id, found.contest)
            return SubmissionDetail(
                submission=submission_views(session, self.settings, evaluations, by, with_output=True)[0],
                episodes=listing.episodes_of(session, by, shown),
                action_matches=action_matches.matches_of(session, by, shown) if is_own else (),
                episodes_with_output=output.episodes_with_output(session, by, shown),
                past=history.past_results(session, by, shown) if is_own else (),
            )

        return await self.read(detail)

    async def public_among(self, submissions: Collection[UUID]) -> Collection[UUID]:
        """Return those of some submissions that everybody may see."""
        return await self.read(lambda session: public_pages.public_among(session, submissions)) if submissions else ()

    async def set_public(self, visitor: Visitor, submission_id: UUID, *, public: bool) -> None:
        """Let everybody see the result of a submission, or its team only."""
        by = visitor.principal
        await self.ask(lambda session: public_pages.set_public(session, by, submission_id, public=public))

    async def submissions(self, visitor: Visitor, before: UUID | None, track: str | None = None) -> SubmissionListView:
        """Return a page of submissions."""
        return await self.read(
            lambda session: listing.list_submissions(
                session, self.settings, visitor.principal, track=track, before=before
            )
        )

    async def output(self, visitor: Visitor, submission_id: UUID, task: str | None, after: int) -> OutputView:
        """Return a page of what a policy printed."""
        by = visitor.principal
        return await self.ask(lambda session: output.episode_outputs(session, by, submission_id, task, after=after))

    async def receipts(self) -> ChainView:
        """Return the state of the chain of receipts."""
        return await self.ask(lambda session: receipts.chain_view(session, after=0, limit=0))

    async def receipt(self, visitor: Visitor, submission_id: UUID) -> Receipt:
        """Return the receipt of a submission's newest result."""
        return await self.ask(lambda session: receipts.newest_receipt(session, visitor.principal, submission_id))

    async def episode(self, visitor: Visitor | None, place: EpisodeAddress) -> ShownEpisodeView:
        """Return a finished episode."""
        by, where = _principal(visitor), (place.submission_id, place.task, place.number)
        return await self.ask(lambda session: asking.shown_episode(session, self.settings, by, *where))

    async def public_episode(self) -> PublicEpisodeView | None:
        """Return the episode that the front page plays."""
        return await self.ask(lambda session: recent.newest_public_episode(session, self.settings))

    async def announcements(self) -> Sequence[AnnouncementView]:
        """Return what the organizers say to everybody."""
        return await self.ask(announcements.shown)

    async def ask_for_playback(self, visitor: Visitor | None, place: EpisodeAddress, address: str) -> PlaybackView:
        """Have the playback of an episode made; requests of visitors count for their address, too."""
        by = _principal(visitor)
        if visitor is None:
            await asyncio.to_thread(self.playbacks.note, address, "playbacks from one address")

        def asked(session: Session) -> PlaybackView:
            episode = asking.find_episode(session, by, place.submission_id, place.task, place.number)
            return asking.playback_view(session, self.settings, asking.ask(session, self.settings, by, episode))

        return await self.ask(asked)

    async def playback_file(self, visitor: Visitor | None, place: EpisodeAddress, file: PlaybackFile) -> bytes:
        """Return a file of an episode's playback."""
        by, where = _principal(visitor), (place.submission_id, place.task, place.number)
        digest = await self.ask(
            lambda session: files.digest_of(session, asking.find_episode(session, by, *where), file)
        )
        return await asyncio.to_thread(files.read, self.database, self.blobs, digest)

    async def sensor(self, visitor: Visitor, submission_id: UUID) -> ShownSensor:
        """Return the sensor of a submission; its file is read outside the transaction."""
        by = visitor.principal

        def found(session: Session) -> tuple[SensorView, str, str]:
            submission = visible(session, by, submission_id)
            return sensors.sensor(session, by, submission_id), submission.name, submission.team.name

        view, name, team = await self.ask(found)
        content = await asyncio.to_thread(self.blobs.read, view.digest)
        looks = await asyncio.to_thread(lambda: appearance(read_made_sensor(content)))
        return ShownSensor(submission_id=submission_id, name=name, team=team, view=view, looks=looks)

    async def design_document(self, visitor: Visitor, submission_id: UUID) -> tuple[DocumentView, bytes]:
        """Return the design document of a submission, read outside the transaction."""
        found = await self.ask(lambda session: sensors.document(session, visitor.principal, submission_id))
        return found, await asyncio.to_thread(self.blobs.read, found.sha256)

    async def cancel(self, visitor: Visitor, submission_id: UUID) -> None:
        """Cancel an evaluation."""
        await self.ask(lambda session: runs.cancel(session, visitor.principal, submission_id))

    async def operations(self) -> OperationsView:
        """Return the state of the service."""
        return await self.ask(lambda session: operations(session, self.settings, totals(session)))

    async def sandboxes(self) -> Sequence[SandboxDescription]:
        """Return what policies find in the sandboxes of the workers."""
        return await self.ask(lambda session: workers.sandboxes(session, self.settings))

    def server_disk(self) -> Disk:
        """Return the disk of this server's state directory."""
        return disk_of(self.settings.state_dir)

    def event_stream(self, visitor: Visitor) -> AbstractAsyncContextManager[None]:
        """Count an event stream while the block runs."""
        return self.streams.one(visitor.principal)

    async def upload(self, visitor: Visitor, announced: AnnouncedUpload, body: AsyncIterator[bytes]) -> UUID:
        """Make a submission out of a body that arrives."""
        by, services = visitor.principal, self.streams.services
        upload.check(services, announced)
        with self.uploads.one(by.account, UPLOADS):
            made, _ = await upload.receive(services, by, announced, body)
        return made.id

    def archive_size(self) -> str:
        """Return the largest size of an archive."""
        return size(self.settings.limits.archive_packed_bytes)

    def log_size(self) -> str:
        """Return the largest size of a log."""
        return size(self.settings.log_bytes)

    def limits(self) -> Sequence[LimitRow]:
        """Return the limits in force."""
        return limit_rows(self.settings.limits)

    async def _visitor(self, authenticated: Awaitable[Principal]) -> Visitor | None:
        try:
            principal = await authenticated
        except ServiceError as error:
            if error.code is ProblemCode.INVALID_CREDENTIALS:
                return None
            raise
        return None if principal.token_id is None else Visitor(principal=principal, token_id=principal.token_id)

    async def ask(self, query: Callable[[Session], ResultT]) -> ResultT:
        """Return what a function of the service layer gives, which may change something."""
        return await asyncio.to_thread(_run, self.database.transaction, query)

    async def read(self, query: Callable[[Session], ResultT]) -> ResultT:
        """Return what a function of the service layer gives that only reads."""
        return await asyncio.to_thread(_run, self.database.reading, query)


def _run(opened: Callable[[], AbstractContextManager[Session]], query: Callable[[Session], ResultT]) -> ResultT:
    with opened() as session:
        return query(session)


def _principal(visitor: Visitor | None) -> Principal:
    """Return who asks, for the service."""
    return VISITOR if visitor is None else visitor.principal
