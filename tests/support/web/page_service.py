"""A service with made-up content below the pages: its functions answer out of `FixedData`; imported by page tests.

Whoever asks with a session of `FixedDatabase` gets what `FixedData` says; every other session gets the real function.
"""

import sys
import tempfile
from collections import Counter
from collections.abc import AsyncIterator, Callable, Collection, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import datetime
from functools import cache, wraps
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any, cast
from uuid import UUID

from fastapi import FastAPI
from made_receipts import a_receipt
from page_fixtures import a_leaderboard, an_operations_view, name_of, some_episodes, some_log_boards
from played_episodes import FixedPlaybacks
from vitac.evaluator.agent.description import SandboxDescription
from vitac.evaluator.tracks import load_track
from vitac.server.accounts import members, messages, quotas, registration, teams, tokens
from vitac.server.api import problems
from vitac.server.api.app import set_limiters
from vitac.server.competitions import view as competition
from vitac.server.database import metrics
from vitac.server.database.states import EvaluationState
from vitac.server.decisions import publishing
from vitac.server.errors import ProblemCode, ServiceError, not_found, token_missing
from vitac.server.evaluations import progress
from vitac.server.leaderboards import descriptions, public_pages, reading
from vitac.server.limiter import WindowLimiter
from vitac.server.operations import state
from vitac.server.playbacks import asking, comparisons, stills, work
from vitac.server.principals import VISITOR, Principal
from vitac.server.queue import workers
from vitac.server.receipts.receipt import Receipt
from vitac.server.services import Services
from vitac.server.settings import Registration, load_settings
from vitac.server.submissions import appeals, comparison, files, listing, runs, sensors, upload
from vitac.server.submissions.intake import AnnouncedUpload
from vitac.server.submissions.watch import Changes
from vitac.server.transparency.notes import make_log_key
from vitac.server.views.comparisons import ComparisonView, PlaybackView, PublicEpisodeView, ShownEpisodeView
from vitac.server.views.competition import (
    ArchiveView,
    CompetitionListView,
    CompetitionState,
    CompetitionSummaryView,
    CompetitionView,
    StageView,
)
from vitac.server.views.correspondence import AnnouncementView
from vitac.server.views.leaderboards import LeaderboardView, LogBoardsView, PastResultView, TeamRanksView
from vitac.server.views.operations import OperationsView
from vitac.server.views.receipts import ActionMatchView, PublicLogView, WitnessView
from vitac.server.views.submissions import (
    DescriptionView,
    DocumentView,
    EpisodeOutputView,
    OutputView,
    SubmissionListView,
    SubmissionView,
)
from vitac.web.pages import routes, submission_detail
from vitac.web.pages.episodes.page import EpisodeAddress
from vitac.web.pages.submission_detail import SubmissionDetail
from vitac.web.pages.submissions import sensors as sensor_pages
from vitac.web.pages.submissions.sensors import ShownSensor
from vitac.web.session.signer import SessionSigner
from vitac.web.site import Site

SIGNER = SessionSigner(key=b"k" * 32)


@cache
def limits_folder() -> Path:
    """The state directory of all these services, which holds nothing but counts."""
    return Path(tempfile.mkdtemp(prefix="vitac-pages-"))


@dataclass(kw_only=True)
class FixedData(FixedPlaybacks):
    """What a service with fixed content has; tokens are `token-of-<name>`."""

    visitors: list[Principal] = field(default_factory=list)
    board: LeaderboardView = field(default_factory=a_leaderboard)
    unfrozen_board: LeaderboardView | None = None
    task_boards: dict[str, LeaderboardView] = field(default_factory=dict)
    found: list[SubmissionView] = field(default_factory=list)
    next_before: UUID | None = None
    page_size: int = 50
    logs: LogBoardsView = field(default_factory=some_log_boards)
    matches: list[ActionMatchView] = field(default_factory=list)
    cancelled: list[UUID] = field(default_factory=list)
    settings: dict[str, Any] = field(default_factory=dict)
    ranks: list[TeamRanksView] = field(default_factory=list)
    takes_appeals: bool = False
    locked_since: datetime | None = None
    cup: CompetitionView | None = None
    public_rankings: list[str] = field(default_factory=list)
    decided_again_at: datetime | None = None
    service: OperationsView = field(default_factory=an_operations_view)
    public_one: PublicEpisodeView | None = None
    said: list[AnnouncementView] = field(default_factory=list)
    printed: list[EpisodeOutputView] = field(default_factory=list)
    past: list[PastResultView] = field(default_factory=list)
    described: list[SandboxDescription] = field(default_factory=list)
    uploaded: list[tuple[AnnouncedUpload, bytes]] = field(default_factory=list)
    sensors: dict[UUID, ShownSensor] = field(default_factory=dict)
    ended: list[UUID | None] = field(default_factory=list)

    def authenticate(self, token: str) -> Principal:
        return self._holder(lambda by: token == f"token-of-{name_of(by)}")

    def principal_of_token_id(self, token_id: UUID) -> Principal:
        return self._holder(lambda by: by.token_id == token_id)

    def sign_in(self, team: str, member: str, password: str, *_: object) -> SimpleNamespace:
        found = self._holder(lambda by: password == f"password-of-{member}" and by.team_name == team)
        return SimpleNamespace(id=found.token_id)

    def _holder(self, is_right: Callable[[Principal], bool]) -> Principal:
        found = next(filter(is_right, self.visitors), None)
        if found is None:
            raise ServiceError(ProblemCode.INVALID_CREDENTIALS, "Nobody has it.")
        return found

    def end_session(self, by: Principal) -> None:
        self.ended.append(by.token_id)

    def register(self, _: object, __: object, new: registration.RegisteringTeam) -> None:
        if self.settings.get("registration") is Registration.INVITE and new.invite != "let me in":
            raise ServiceError(ProblemCode.INVITE_REQUIRED, "Registration needs the invite code.")

    def leaderboard(
        self,
        by: Principal,
        track: str,
        *,
        task: str | None = None,
        stage: str | None = None,
        competition: str | None = None,
    ) -> SimpleNamespace:
        if task is not None and task not in load_track(track).tasks:
            raise ServiceError(ProblemCode.UNKNOWN_TASK, f"There is no task {task!r} of {track}.")
        board = self.board if task is None else self.task_boards.get(task, a_leaderboard(task=task))
        if by.organizes(competition or "") and self.unfrozen_board is not None:
            board = self.unfrozen_board
        return SimpleNamespace(view=board.model_copy(update={"stage": stage}))

    def competition(self, _: str | None = None) -> CompetitionView:
        if self.cup is None:
            raise ServiceError(ProblemCode.NOT_FOUND, "This service runs no competition.")
        return self.cup

    def list_competitions(self) -> CompetitionListView:
        if self.cup is None:
            return CompetitionListView(items=[])
        held = [track for track in self.cup.tracks if track.taken_here]
        summary = CompetitionSummaryView(
            name=self.cup.name,
            title=self.cup.title,
            summary=self.cup.summary,
            opens=min(stage.opens for track in self.cup.tracks for stage in track.stages),
            closes=max(stage.closes for track in self.cup.tracks for stage in track.stages),
            state=CompetitionState.FINAL if self.cup.finalized_at else CompetitionState.OPEN,
            tracks=[track.name for track in held],
            public_rankings=self.public_rankings,
        )
        return CompetitionListView(items=[summary])

    def stages(self, track: str, _: str | None = None) -> Sequence[StageView]:
        tracks = self.cup.tracks if self.cup else ()
        return next((found.stages for found in tracks if found.name == track), ())

    def archive(self, _: str | None = None) -> ArchiveView:
        return ArchiveView(
            competition=self.competition(),
            boards=[self.board],
            public_key=a_receipt().public_key,
            decided_again_at=self.decided_again_at,
            citation="@misc{cup}",
        )

    def log_boards(
        self, _: Principal, track: str, *, stage: str | None = None, competition: str | None = None
    ) -> SimpleNamespace:
        del competition
        return SimpleNamespace(view=self.logs.model_copy(update={"stage": stage, "track": track}))

    def public_among(self, submissions: Collection[UUID]) -> frozenset[UUID]:
        return frozenset(found.id for found in self.found if found.public and found.id in submissions)

    def descriptions_among(self, _: Principal, public: Collection[UUID]) -> dict[UUID, DescriptionView]:
        return {found.id: found.description for found in self.found if found.id in public and found.description}

    def set_public(self, by: Principal, submission_id: UUID, *, public: bool) -> None:
        self.submission(None, by, submission_id)
        self.found = [
            found.model_copy(update={"public": public}) if found.id == submission_id else found for found in self.found
        ]

    def submission(self, _: object, by: Principal, submission_id: UUID) -> SubmissionDetail:
        for submission in self.found:
            is_own = self.may_see(by, submission)
            if submission.id == submission_id and (is_own or submission.public):
                progress = submission.evaluation.progress
                return SubmissionDetail(
                    submission=submission,
                    episodes=[end for task in progress.tasks for end in some_episodes(task.task, task.episodes_done)],
                    action_matches=self.matches if submission.log else [],
                    episodes_with_output=len(self.printed) if is_own else 0,
                    past=self.past if is_own else [],
                )
        raise token_missing() if by == VISITOR else not_found("submission", submission_id)

    def compare(self, settings: object, by: Principal, ids: Sequence[UUID]) -> ComparisonView:
        details = [self.submission(settings, by, submission_id) for submission_id in ids]
        return comparison.make_comparison([comparison.make_side(one.submission, one.episodes) for one in details])

    def may_see(self, by: Principal, submission: SubmissionView) -> bool:
        return by.reads_all_teams or by.team_name == submission.team.name

    def get(self, _: object, by: Principal, submission_id: UUID) -> SubmissionView:
        return self.submission(None, by, submission_id).submission

    def submissions(
        self, _: object, by: Principal, *, track: str | None = None, before: UUID | None = None
    ) -> SubmissionListView:
        del before
        seen = [found for found in self.found if self.may_see(by, found) and track in (None, found.track)]
        return SubmissionListView(items=seen[: self.page_size], next_before=self.next_before)

    def output(self, by: Principal, submission_id: UUID, task: str | None, *, after: int) -> OutputView:
        tasks = self.get(None, by, submission_id).tasks
        later = [item for item in self.printed if item.task == (task or tasks[0]) and item.episode > after]
        return OutputView(items=later[:2], next_after=later[1].episode if len(later) > 2 else None)

    def log(self, **_: int) -> PublicLogView:
        receipt = a_receipt()
        (proof,) = receipt.parsed_proofs()
        return PublicLogView(
            public_key=receipt.public_key,
            verifier_key=str(make_log_key(bytes.fromhex(receipt.public_key))),
            receipts=1,
            root=proof.checkpoint.root.hex(),
            checkpoint=str(proof.checkpoint),
            witnesses=[WitnessView(witness="ants.example+1+2", size=0, behind=1, behind_s=60.0, signed_at=None)],
            items=[],
            next_after=None,
        )

    def receipt(self, by: Principal, submission_id: UUID) -> Receipt:
        self.get(None, by, submission_id)
        return a_receipt()

    def find_episode(
        self, by: Principal, submission_id: UUID, task: str, number: int, *, practice: bool = False
    ) -> EpisodeAddress:
        self.get(None, by, submission_id)
        return EpisodeAddress(submission_id=submission_id, task=task, number=number, practice=practice)

    def shown_episode(self, _: object, *where: Any, **named: Any) -> ShownEpisodeView:
        return self.shown_at(self.find_episode(*where, **named))

    def ask(self, _: object, __: Principal, place: EpisodeAddress) -> PlaybackView:
        return self.ask_at(place)

    def sensor(self, by: Principal, submission_id: UUID) -> ShownSensor:
        self.get(None, by, submission_id)
        if submission_id not in self.sensors:
            raise not_found("sensor of submission", submission_id)
        return self.sensors[submission_id]

    def document(self, by: Principal, submission_id: UUID) -> DocumentView:
        return self.sensor(by, submission_id).view.document

    def cancel(self, by: Principal, submission_id: UUID) -> None:
        if self.get(None, by, submission_id).evaluation.state is EvaluationState.COMPLETED:
            raise ServiceError(ProblemCode.NOT_CANCELLABLE, "The evaluation has ended.")
        self.cancelled.append(submission_id)

    async def receive(
        self, by: Principal, announced: AnnouncedUpload, body: AsyncIterator[bytes]
    ) -> tuple[SubmissionView, bool]:
        content = b""
        async for piece in body:
            content += piece
            if content.startswith(b"broken"):
                raise ServiceError(ProblemCode.ARCHIVE_REJECTED, "The archive is <broken>. Pack it again.")
        self.uploaded.append((announced, content))
        return next(found for found in self.found if self.may_see(by, found)), content != b"known"


@dataclass(frozen=True, kw_only=True)
class FixedDatabase:
    """The database of such a service; it is its own session."""

    data: FixedData

    @contextmanager
    def transaction(self) -> Iterator["FixedDatabase"]:
        yield self

    reading = transaction

    def flush(self) -> None:
        """Keep what was changed, as it is kept already."""


def answered_by(data_of: Callable[[FixedData], Callable[..., Any]], module: ModuleType, name: str) -> None:
    """Have a function of the service answered by fixed data where its first argument belongs to it."""
    real = getattr(module, name)

    @wraps(real)
    def answer(first: Any, *given: Any, **named: Any) -> Any:
        database = first
        if isinstance(first, Services):
            database = first.database
        elif isinstance(first, Site):
            database = first.services.database
        if isinstance(database, FixedDatabase):
            return data_of(database.data)(*given, **named)
        return real(first, *given, **named)

    for loaded in [found for key, found in sys.modules.items() if key.startswith("vitac.")]:
        for attribute in [key for key, value in vars(loaded).items() if value is real]:
            setattr(loaded, attribute, answer)


def playback_of(data: FixedData) -> Callable[..., PlaybackView]:
    return lambda _, playback: playback


async def _sensor(data: FixedData, by: Principal, submission_id: UUID) -> ShownSensor:
    return data.sensor(by, submission_id)


for _module, _name, _data_of in (
    (tokens, "authenticate", lambda data: data.authenticate),
    (tokens, "principal_of_token_id", lambda data: data.principal_of_token_id),
    (tokens, "end_session", lambda data: data.end_session),
    (members, "sign_in", lambda data: data.sign_in),
    (registration, "register", lambda data: data.register),
    (teams, "find_lock_date", lambda data: lambda: data.locked_since),
    (reading, "shown_leaderboard", lambda data: data.leaderboard),
    (reading, "shown_log_boards", lambda data: data.log_boards),
    (competition, "competition_view", lambda data: data.competition),
    (competition, "competition_list_view", lambda data: data.list_competitions),
    (competition, "list_choices", lambda _: list),
    (competition, "track_stages", lambda data: data.stages),
    (publishing, "archive_view", lambda data: data.archive),
    (public_pages, "public_among", lambda data: data.public_among),
    (public_pages, "set_public", lambda data: data.set_public),
    (descriptions, "descriptions_among", lambda data: data.descriptions_among),
    (submission_detail, "read_detail", lambda data: data.submission),
    (listing, "get", lambda data: data.get),
    (listing, "list_submissions", lambda data: data.submissions),
    (progress, "count_open", lambda data: lambda: Counter(each.evaluation.state for each in data.found)),
    (reading, "shown_rank_history", lambda data: lambda *_, **__: data.ranks),
    (appeals, "takes_appeals", lambda data: lambda *_: data.takes_appeals),
    (comparison, "compare_results", lambda data: data.compare),
    (files, "episode_outputs", lambda data: data.output),
    (files, "log_view", lambda data: data.log),
    (files, "newest_receipt", lambda data: data.receipt),
    (asking, "find_episode", lambda data: data.find_episode),
    (asking, "shown_episode", lambda data: data.shown_episode),
    (asking, "ask", lambda data: data.ask),
    (asking, "playback_view", playback_of),
    (stills, "list_stills", lambda data: lambda *_: data.stills),
    (stills, "find_stills", lambda data: lambda _, ids: dict.fromkeys(ids, data.stills[0]) if data.stills else {}),
    (comparisons, "list_choices", lambda _: lambda *_, **__: ()),
    (stills, "newest_public_episode", lambda data: lambda _: data.public_one),
    (messages, "list_announcements", lambda data: lambda *_, **__: data.said),
    (asking, "find_digest", lambda data: lambda place, file: (place, file)),
    (work, "read_file", lambda data: lambda _, key: data.file_at(*key)),
    (sensors, "document", lambda data: data.document),
    (sensor_pages, "_shown_sensor", lambda data: lambda *given: _sensor(data, *given)),
    (runs, "cancel", lambda data: data.cancel),
    (state, "operations", lambda data: lambda *_: data.service),
    (metrics, "totals", lambda data: dict),
    (workers, "sandboxes", lambda data: lambda _: data.described),
    (quotas, "find_limit", lambda data: lambda *_: 100),
    (upload, "receive", lambda data: data.receive),
):
    answered_by(_data_of, _module, _name)


def a_site(data: FixedData, tracks: tuple[str, ...] = ("track_1",)) -> Site:
    """What the pages over fixed content share."""
    settings = load_settings(database_url="postgresql:///elsewhere", state_dir=limits_folder(), **data.settings)
    blobs = SimpleNamespace(read=lambda _: b"<script>")
    services = Services(
        settings=settings, database=cast(Any, FixedDatabase(data=data)), blobs=cast(Any, blobs), postgres=None
    )
    playbacks = WindowLimiter(limits_folder() / "playbacks", limit=1000, window_s=1.0)
    return Site(services=services, playbacks=playbacks, signer=SIGNER, version="0.1.0", tracks=tracks)


def an_application(data: FixedData, tracks: tuple[str, ...] = ("track_1",)) -> FastAPI:
    """Pages over fixed content, as `vitac serve` mounts them."""
    app, site = FastAPI(docs_url=None, redoc_url=None), a_site(data, tracks)
    app.state.changes = Changes()
    app.state.settings, app.state.services = site.services.settings, site.services
    set_limiters(app, site.services.settings.model_copy(update={"sign_ins_per_hour": 100_000} | data.settings))
    problems.install(app)
    routes.install(app, site)
    return app
