"""Views with made-up but consistent numbers, and a service that answers the pages with them; imported by page tests."""

import random
from collections.abc import AsyncIterator, Callable, Collection, Sequence
from contextlib import AbstractAsyncContextManager, nullcontext
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from hashlib import sha256
from typing import Any
from uuid import UUID, uuid5

from fastapi import FastAPI
from made_receipts import a_receipt
from played_episodes import FixedPlaybacks
from sqlalchemy.orm import Session
from vitac.envs.tasks.definition import Family
from vitac.evaluator.agent.description import SandboxDescription
from vitac.evaluator.logs.findings import VerificationResult
from vitac.evaluator.scoring.ranking import CombinedScore, combine
from vitac.evaluator.scoring.score import Score, rate
from vitac.evaluator.submission_kinds import SubmissionKind
from vitac.evaluator.tracks import ListKind, load_track
from vitac.server.api import problems
from vitac.server.db.states import EvaluationState, Role, WorkerState
from vitac.server.errors import ProblemCode, ServiceError, not_found, token_missing
from vitac.server.playbacks.files import PlaybackFile
from vitac.server.principals import Principal
from vitac.server.queue.workers import Disk
from vitac.server.receipts.receipt import Receipt
from vitac.server.settings import Registration, load_settings
from vitac.server.submissions.upload import AnnouncedUpload
from vitac.server.views.archive import ArchiveView
from vitac.server.views.contest import (
    CompetitionSummaryView,
    CompetitionTrackView,
    CompetitionView,
    PrizeView,
    StageView,
    WinnerView,
)
from vitac.server.views.evaluations import (
    EvaluationSummaryView,
    EvaluationView,
    ProgressView,
    TaskProgressView,
    VerdictView,
)
from vitac.server.views.leaderboards import (
    LeaderboardEntryView,
    LeaderboardView,
    LogBoardsView,
    LogBoardView,
    LogEntryView,
    PastResultView,
    TextLogEntryView,
)
from vitac.server.views.logs import ActionMatchView, DivergenceView, LogCopyView, LogView, MatchedEpisodeView
from vitac.server.views.messages import AnnouncementView
from vitac.server.views.operations import CountsView, MachineWorkerView, OperationsView, QueueView, StorageView
from vitac.server.views.playbacks import PlaybackView, PublicEpisodeView, ShownEpisodeView
from vitac.server.views.receipts import ChainView
from vitac.server.views.scores import ShapeScoreView, TaskScoreView
from vitac.server.views.submissions import (
    DocumentView,
    EpisodeOutputView,
    EpisodeView,
    OutputView,
    RankView,
    SubmissionListView,
    SubmissionView,
)
from vitac.server.views.teams import TeamView
from vitac.server.views.workers import WorkersView, WorkerView
from vitac.web.data.protocol import (
    EpisodeAddress,
    LimitRow,
    PasswordSignIn,
    RegisteredTeam,
    ResultT,
    ShownSensor,
    SubmissionDetail,
    Visitor,
)
from vitac.web.pages import routes
from vitac.web.session.signer import SessionSigner
from vitac.web.site import Site

NOW = datetime(2026, 11, 21, 3, 15, tzinfo=UTC)
WITHIN_TOLERANCE = VerificationResult.WITHIN_TOLERANCE
NAMESPACE = UUID("5ecf6a5e-8f3c-4b0e-9d5e-000000000000")
TASK = "peg-insertion"
LOCK = "lock-opening"
TASKS = load_track("track_1").tasks
SIGNER = SessionSigner(key=b"k" * 32)


def an_id(name: str) -> UUID:
    """The same id for the same name."""
    return uuid5(NAMESPACE, name)


def a_team(name: str) -> TeamView:
    """A team of that name."""
    return TeamView(id=an_id(name), name=name, shown_as=name, created_at=NOW)


def a_score(successes: tuple[int, ...], mean_steps: float | None, task: str = TASK) -> TaskScoreView:
    """A score with so many successes for each shape of a task."""
    shapes, total = TASKS[task].episode_list.shapes, len(TASKS[task].episodes)
    each = total // len(shapes)
    whole = rate(sum(successes), total)
    parts = [(shape, rate(count, each)) for shape, count in zip(shapes, successes, strict=True)]
    return TaskScoreView(
        task=task,
        episodes=total,
        successes=whole.successes,
        success_rate=whole.success_rate,
        success_rate_interval=(whole.interval.low, whole.interval.high),
        mean_steps=mean_steps,
        shapes=[
            ShapeScoreView(
                shape=shape,
                episodes=each,
                successes=part.successes,
                success_rate=part.success_rate,
                success_rate_interval=(part.interval.low, part.interval.high),
            )
            for shape, part in parts
        ],
        outcomes={"success": whole.successes, "tactile": total - whole.successes},
        result_hash="9f3b" * 16 if task == TASK else "5c7e" * 16,
    )


def combined(scores: Sequence[TaskScoreView]) -> CombinedScore:
    """What scores make together."""
    return combine(
        TASKS,
        {
            score.task: Score(
                **dict(rate(score.successes, score.episodes)), mean_steps=score.mean_steps, by_shape={}, outcomes={}
            )
            for score in scores
        },
    )


def an_entry(
    rank: int | None, team: str, *scores: TaskScoreView, name: str = "policy", task: str | None = None
) -> LeaderboardEntryView:
    """A line of a leaderboard; without a rank it is from another evaluator version."""
    ranked = [score for score in scores if task in {None, score.task}]
    whole = combined(scores)
    result = ranked[0] if task else whole
    interval = ranked[0].success_rate_interval if task else (whole.interval.low, whole.interval.high)
    return LeaderboardEntryView(
        rank_range=None,
        rank=rank,
        stale=rank is None,
        team=team,
        evaluation_id=an_id(f"{team}/{name}/{scores}"),
        submission_id=an_id(f"{team}/{name}"),
        submission_name=name,
        kind=SubmissionKind.MODEL,
        submitted_at=NOW - timedelta(hours=3),
        evaluated_at=NOW,
        episodes=sum(score.episodes for score in ranked),
        successes=sum(score.successes for score in ranked),
        success_rate=result.success_rate,
        success_rate_interval=interval,
        mean_steps=result.mean_steps,
        scores=ranked,
        result_hash="9f3b" * 16,
        evaluator_version="1+0123456789ab" if rank else "1+ba9876543210",
        list_kind=ListKind.PUBLIC,
    )


def a_leaderboard(*entries: LeaderboardEntryView, task: str | None = None) -> LeaderboardView:
    """A leaderboard of Track 1, or of one of its tasks."""
    track = load_track("track_1")
    return LeaderboardView(
        track=track.name,
        title=track.title,
        tasks=list(track.tasks),
        task=task,
        stage=None,
        list_kind=ListKind.PUBLIC,
        frozen_at=None,
        ranking_rule=track.ranking_rule if task else track.combination_rule or "",
        evaluator_version="1+0123456789ab",
        revision=sha256("".join(entry.model_dump_json() for entry in entries).encode()).hexdigest(),
        generated_at=NOW,
        teams=len(entries),
        entries=list(entries),
    )


def a_submission(
    team: str,
    state: EvaluationState,
    *,
    name: str = "policy",
    tasks: Sequence[str] = (TASK,),
    done: int = 0,
    workers: int = 1,
    verdict: VerdictView | None = None,
    log_tail: str = "",
    reused: int = 0,
) -> SubmissionView:
    """A submission whose evaluation is in a state; a completed one has all episodes and its scores."""
    completed = state is EvaluationState.COMPLETED
    active = state in {EvaluationState.QUEUED, EvaluationState.RUNNING}
    scores = [MADE_UP_SCORES[task] for task in tasks] if completed else []
    result = combined(scores) if completed else None
    summary = EvaluationSummaryView(
        id=an_id(f"{team}/{name}/evaluation"),
        run=1,
        state=state,
        evaluator_version="1+0123456789ab",
        created_at=NOW,
        finished_at=None if active else NOW + timedelta(seconds=54),
        result_hash="9f3b" * 16 if completed else None,
    )
    evaluation = EvaluationView(
        **dict(summary),
        started_at=None if state is EvaluationState.QUEUED else NOW,
        queue_position=2 if state is EvaluationState.QUEUED else None,
        eta_s=41.0 if state is EvaluationState.RUNNING else None,
        progress=a_progress(tasks, None if completed else done, reused),
        verdict=verdict,
        log_tail=log_tail,
        success_rate=result.success_rate if result else None,
        success_rate_interval=(result.interval.low, result.interval.high) if result else None,
        mean_steps=result.mean_steps if result else None,
        scores=scores,
        counted_tasks=list(TASKS),
        evaluator_hash="01234567" * 8,
        platform_class="x86_64-linux",
        isolation=[] if state is EvaluationState.QUEUED else ["user-namespace, memory by cgroup-v2"],
        list_kind=ListKind.PUBLIC,
        commitment=None,
        episodes_hidden=False,
        differing_episodes=None,
    )
    return SubmissionView(
        id=an_id(f"{team}/{name}"),
        team=a_team(team),
        kind=SubmissionKind.MODEL,
        track="track_1",
        stage=None,
        tasks=list(tasks),
        missing_tasks=[task for task in TASKS if task not in tasks],
        name=name,
        digest="c0ffee00" * 8,
        archive_sha256="00" * 32,
        archive_bytes=1234,
        submitted_at=NOW,
        public=False,
        evaluation=evaluation,
        evaluations=[summary],
        workers=WorkersView(alive=workers, last_heartbeat_at=NOW),
        log=None,
        rank=RankView(rank=2, of=4) if completed else None,
        unranked=None,
        task_ranks={task: RankView(rank=1, of=3) for task in tasks} if completed else {},
    )


MADE_UP_SCORES = {TASK: a_score((80, 74, 80), 4.92), LOCK: a_score((31, 24, 40, 1), 12.5, LOCK)}


def a_progress(tasks: Sequence[str], done: int | None, reused: int) -> ProgressView:
    """So many finished episodes (None: all), the first task's first, every second one a success."""
    views = []
    for task in tasks:
        total = len(TASKS[task].episodes)
        of_task = total if done is None else min(done, total)
        done = None if done is None else done - of_task
        views.append(TaskProgressView(task=task, episodes_done=of_task, episodes_total=total, successes=of_task // 2))
    return ProgressView(
        episodes_done=sum(view.episodes_done for view in views),
        episodes_total=sum(view.episodes_total for view in views),
        episodes_reused=reused,
        successes=sum(view.successes or 0 for view in views),
        tasks=views,
    )


def some_episodes(task: str, count: int) -> list[EpisodeView]:
    """The first episodes of a task's list, most of them successful."""
    chance = random.Random(3)  # noqa: S311 - made-up outcomes
    outcomes = chance.choices(["success", "tactile", "steps", "error"], [80, 10, 6, 2], k=count)
    return [
        EpisodeView(
            task=task,
            episode=episode.number,
            shape=episode.shape,
            outcome=outcome,
            success=outcome == "success",
            env_steps=chance.randint(3, 8),
        )
        for episode, outcome in zip(TASKS[task].episodes[:count], outcomes, strict=True)
    ]


def a_log(
    state: EvaluationState,
    verdict: VerificationResult | None,
    *,
    kind: SubmissionKind = SubmissionKind.LOG,
    **changes: Any,
) -> SubmissionView:
    """A log of the Gelbots; `changes` are those of its `LogView`."""
    text_log = kind is SubmissionKind.TEXT_LOG
    values: dict[str, Any] = {
        "label": "2025 text log" if text_log else "actions verified, policy not seen",
        "verdict": verdict,
        "reason": None,
        "divergence": None,
        "claimed_episodes": 270,
        "claimed_successes": 243,
        "claimed_success_rate": 0.9,
        "claimed_mean_steps": 4.5,
        "claimed_result_hash": None if text_log else "9f3b" * 16,
        "team_named": "Gelbots",
        "submission_digest_named": None,
        "made_on": None if text_log else "x86_64-linux",
        "copy_of": None,
        "problems": [],
    }
    log = LogView(**(values | changes))
    submission = a_submission("Gelbots", state, name=f"{log.label}, {verdict or state}")
    scores = submission.evaluation.scores[:1]
    return submission.model_copy(
        update={
            "kind": kind,
            "log": log,
            "tasks": [TASK],
            "missing_tasks": [],
            "evaluation": submission.evaluation.model_copy(update={"scores": scores}),
        }
    )


DIVERGENCE = DivergenceView(
    episode=31,
    env_step=2,
    recorded_state="ab" * 32,
    recorded_info={"is_success": True, "surface_diff_m": None},
    resimulated_state="cd" * 32,
    resimulated_info={"is_success": False, "surface_diff_m": [0.0004321987, 0.0005]},
)


def an_action_match() -> ActionMatchView:
    """A model that gives all but two of a log's actions."""
    return ActionMatchView(
        submission_id=an_id("model"),
        submission_name="my model",
        evaluated_at=NOW,
        actions=810,
        reproduced=808,
        episodes=270,
        episodes_reproduced=269,
        others=[MatchedEpisodeView(episode=5, actions=3, reproduced=1, first_mismatch=2)],
    )


def some_log_boards() -> LogBoardsView:
    """Two verified logs of the peg task, none of the lock's, and a 2025 text log."""
    track = load_track("track_1")
    entries = [
        a_log_entry(1, "Gelbots", 243, VerificationResult.VERIFIED),
        a_log_entry(2, "Bears", 40, WITHIN_TOLERANCE),
    ]
    return LogBoardsView(
        track=track.name,
        title=track.title,
        stage=None,
        label="actions verified, policy not seen",
        ranking_rule="Higher success rate first.",
        evaluator_version="1+0123456789ab",
        revision="c0ffee",
        generated_at=NOW,
        boards=[
            LogBoardView(task=name, title=task.title, entries=entries if name == TASK else [])
            for name, task in track.tasks.items()
        ],
        why_rates_differ="Because they do.",
        text_logs=[
            TextLogEntryView(
                team="Touch",
                task="lock-opening",
                evaluation_id=an_id("evaluation of the text log"),
                submission_id=an_id("text log"),
                submission_name="2025 text log 0a1b2c3d",
                submitted_at=NOW,
                claimed_success_rate=0.9063,
                claimed_mean_steps=6.34,
                success_rate=0.85,
                mean_steps=6.51,
                problems=1,
                evaluator_version="1+0123456789ab",
            )
        ],
    )


def a_log_entry(place: int, team: str, successes: int, verdict: VerificationResult) -> LogEntryView:
    """A line of the logs' ranking."""
    whole = rate(successes, 270)
    return LogEntryView(
        rank=place,
        stale=False,
        team=team,
        evaluation_id=an_id(f"evaluation of the log of {team}"),
        submission_id=an_id(f"log of {team}"),
        submission_name="log 0a1b2c3d",
        verdict=verdict,
        copy_of=LogCopyView(team="Gelbots", episodes=200, ranked=True) if team == "Bears" else None,
        submitted_at=NOW,
        episodes=270,
        successes=successes,
        success_rate=whole.success_rate,
        success_rate_interval=(whole.interval.low, whole.interval.high),
        mean_steps=4.5,
        result_hash="9f3b" * 16,
        evaluator_version="1+0123456789ab",
        list_kind=ListKind.PUBLIC,
    )


def a_visitor(name: str, role: Role = Role.TEAM) -> Visitor:
    """Somebody with a token of a team (or of the organizers)."""
    team = name if role is Role.TEAM else None
    principal = Principal(role=role, team_id=an_id(name) if team else None, team_name=team, token_id=an_id(f"t:{name}"))
    return Visitor(principal=principal, token_id=an_id(f"t:{name}"))


def a_worker(state: WorkerState, *, is_lost: bool = False, message: str = "") -> MachineWorkerView:
    """A worker on a machine with a disk of 100 GiB."""
    worker = WorkerView(
        id=an_id(f"worker {state} {is_lost}"),
        host="machine-1",
        pid=4711,
        slots=2,
        state=state,
        message=message,
        isolation="user: root, memory: cgroup-v1",
        evaluator_version="1+0123456789ab",
        families=[Family.TACTILE, Family.MANISKILL],
        platform_class="x86_64-linux",
        started_at=NOW - timedelta(hours=2),
        heartbeat_at=NOW,
        disk_bytes=100 << 30,
        disk_free_bytes=12 << 30,
    )
    return MachineWorkerView(worker=worker, is_lost=is_lost)


def an_operations_view(*workers: MachineWorkerView) -> OperationsView:
    """A busy service."""
    return OperationsView(
        queue=QueueView(
            shards_queued=18_000,
            shards_running=4,
            oldest_shard_s=3660.0,
            evaluations_queued=2000,
            evaluations_running=2,
            oldest_evaluation_s=3660.0,
        ),
        storage=StorageView(uploads=1234, uploads_bytes=5 << 30, database_bytes=700 << 20),
        workers=list(workers),
        episodes_in_5_minutes=270,
        counts=CountsView(
            episodes=123_456,
            shards_finished=4100,
            shard_retries=3,
            shards_given_up=0,
            leases_lost=1,
            requests=9000,
            requests_failed=2,
            requests_within_s=0.05,
            claims_within_s=0.02,
            shard_waits_within_s=float("inf"),
        ),
        at=NOW,
    )


def a_past_result(name: str, success_rate: float, days_ago: int, task: str = TASK) -> PastResultView:
    """What a submission of the Gelbots has reached."""
    return PastResultView(
        task=task,
        submission_id=an_id(f"Gelbots/{name}"),
        submission_name=name,
        submitted_at=NOW - timedelta(days=days_ago),
        success_rate=success_rate,
    )


def a_sandbox(**changes: Any) -> SandboxDescription:
    """What a policy finds on a worker."""
    values: dict[str, Any] = {
        "python": "3.11.9",
        "machine": "x86_64",
        "c_library": "glibc 2.36",
        "cores": 2,
        "blas": "scipy-openblas 0.3.31",
        "threads": {"OMP_NUM_THREADS": "1"},
        "simd": ("X86_V2", "X86_V3"),
        "packages": {"numpy": "2.4.6", "pydantic": "2.14.0"},
    }
    return SandboxDescription(**(values | changes))


def a_finished_cup() -> CompetitionView:
    """A competition that is final, with one winner."""
    stage = StageView(
        name="final", title="Final", opens=NOW - timedelta(days=9), closes=NOW, is_open=False,
        accepts=[SubmissionKind.MODEL], list_kind=ListKind.SEALED, commitment="9f3b" * 16, secret="9f3b" * 16,
        scored_runs=3, attempts=None, qualified="the best 10 teams",
    )  # fmt: skip
    prize = PrizeView(place="first", amount=2000, winners=1, note="a talk")
    track = CompetitionTrackView(
        name="track_1", title="Touch", taken_here=True, ranking=["success_rate"], ties="", stages=[stage],
        prizes=[prize],
    )  # fmt: skip
    won = WinnerView(
        track="track_1", place="first", rank=1, team="<Bears>", amount=2000, success_rate=0.9, result_hash="9f3b" * 16
    )
    return CompetitionView(
        name="cup", title="The cup", summary="", website=None, contact=None, rules=[], currency="USD",
        teams_locked=None, tracks=[track], frozen_at=None, finalized_at=datetime(2031, 3, 1, tzinfo=UTC), winners=[won],
    )  # fmt: skip


@dataclass(kw_only=True)
class FixedData(FixedPlaybacks):
    """A service with fixed content; tokens are `token-of-<name>`. Implements `PageData`."""

    visitors: list[Visitor] = field(default_factory=list)
    board: LeaderboardView = field(default_factory=a_leaderboard)
    unfrozen_board: LeaderboardView | None = None
    task_boards: dict[str, LeaderboardView] = field(default_factory=dict)
    found: list[SubmissionView] = field(default_factory=list)
    next_before: UUID | None = None
    page_size: int = 50
    logs: LogBoardsView = field(default_factory=some_log_boards)
    matches: list[ActionMatchView] = field(default_factory=list)
    cancelled: list[UUID] = field(default_factory=list)
    registration_rule: Registration = Registration.OPEN
    locked_since: datetime | None = None
    cup: CompetitionView | None = None
    decided_again_at: datetime | None = None
    service: OperationsView = field(default_factory=an_operations_view)
    public_one: PublicEpisodeView | None = None
    said: list[AnnouncementView] = field(default_factory=list)
    printed: list[EpisodeOutputView] = field(default_factory=list)
    past: list[PastResultView] = field(default_factory=list)
    described: list[SandboxDescription] = field(default_factory=list)
    uploaded: list[tuple[AnnouncedUpload, bytes]] = field(default_factory=list)
    sensors: dict[UUID, ShownSensor] = field(default_factory=dict)
    tried_from: list[str] = field(default_factory=list)
    ended: list[UUID] = field(default_factory=list)

    async def ask(self, query: Callable[[Session], ResultT]) -> ResultT:
        raise LookupError("there is no database behind these pages; tests of pages that ask it start a service")

    async def note_registration(self, address: str) -> None:
        self.tried_from.append(address)

    async def visitor_with_password(self, given: PasswordSignIn) -> Visitor | None:
        self.tried_from.append(given.address)
        if len(self.tried_from) > 3:
            raise ServiceError(ProblemCode.TOO_MANY_REQUESTS, "At most 3 tries are possible; wait.")
        known = given.password == f"password-of-{given.member}"
        return next((visitor for visitor in self.visitors if known and visitor.name == given.team), None)

    async def end_session(self, visitor: Visitor) -> None:
        self.ended.append(visitor.token_id)

    async def visitor_with_token(self, token: str) -> Visitor | None:
        return next((visitor for visitor in self.visitors if token == f"token-of-{visitor.name}"), None)

    async def visitor_with_token_id(self, token_id: UUID) -> Visitor | None:
        return next((visitor for visitor in self.visitors if visitor.token_id == token_id), None)

    def registration(self) -> Registration:
        return self.registration_rule

    async def teams_locked_since(self) -> datetime | None:
        return self.locked_since

    async def register(self, *, name: str, contact: str, invite: str, address: str) -> RegisteredTeam:
        if name == "Bears":
            raise ServiceError(ProblemCode.TEAM_EXISTS, "There is a team named 'Bears' already.")
        if self.registration_rule is Registration.INVITE and invite != "let me in":
            raise ServiceError(ProblemCode.INVITE_REQUIRED, "Registration needs the invite code.")
        visitor = self.visitors[0]
        return RegisteredTeam(team=name, token="vitac_made", token_id=visitor.token_id)  # noqa: S106 - made up

    async def leaderboard(
        self,
        track: str,
        task: str | None,
        stage: str | None = None,
        *,
        contest: str | None = None,
        visitor: Visitor | None = None,
    ) -> LeaderboardView:
        if task is not None and task not in TASKS:
            raise ServiceError(ProblemCode.UNKNOWN_TASK, f"There is no task {task!r}.")
        board = self.board if task is None else self.task_boards.get(task, a_leaderboard(task=task))
        if visitor is not None and visitor.is_organizer and self.unfrozen_board is not None:
            board = self.unfrozen_board
        return board.model_copy(update={"stage": stage})

    async def competitions(self) -> Sequence[CompetitionSummaryView]:
        return ()

    async def competitions_to_choose_from(self) -> Sequence[CompetitionSummaryView]:
        return ()

    async def competition(self, name: str | None = None) -> CompetitionView:
        if self.cup is None:
            raise ServiceError(ProblemCode.NOT_FOUND, "This service runs no competition.")
        return self.cup

    async def stages(self, track: str, contest: str | None = None) -> Sequence[StageView]:
        tracks = self.cup.tracks if self.cup else ()
        return next((found.stages for found in tracks if found.name == track), ())

    async def archive(self, name: str | None = None) -> ArchiveView:
        found = await self.competition()
        key = a_receipt().link.public_key
        return ArchiveView(
            competition=found,
            boards=[self.board],
            public_key=key,
            decided_again_at=self.decided_again_at,
            citation="@misc{cup}",
        )

    async def log_boards(
        self, track: str, stage: str | None = None, *, contest: str | None = None, visitor: Visitor | None = None
    ) -> LogBoardsView:
        return self.logs.model_copy(update={"stage": stage})

    async def public_among(self, submissions: Collection[UUID]) -> frozenset[UUID]:
        return frozenset(found.id for found in self.found if found.public and found.id in submissions)

    async def set_public(self, visitor: Visitor, submission_id: UUID, *, public: bool) -> None:
        await self.submission(visitor, submission_id)
        self.found = [
            found.model_copy(update={"public": public}) if found.id == submission_id else found for found in self.found
        ]

    async def submission(self, visitor: Visitor | None, submission_id: UUID) -> SubmissionDetail:
        for submission in self.found:
            is_own = visitor is not None and visitor.may_see(submission.team.name)
            if submission.id == submission_id and (is_own or submission.public):
                progress = submission.evaluation.progress
                return SubmissionDetail(
                    submission=submission,
                    episodes=[end for task in progress.tasks for end in some_episodes(task.task, task.episodes_done)],
                    action_matches=self.matches if submission.log else [],
                    episodes_with_output=len(self.printed) if is_own else 0,
                    past=self.past if is_own else [],
                )
        raise token_missing() if visitor is None else not_found("submission", submission_id)

    async def submissions(self, visitor: Visitor, before: UUID | None, track: str | None = None) -> SubmissionListView:
        seen = [submission for submission in self.found if visitor.may_see(submission.team.name)]
        of_track = [submission for submission in seen if track in (None, submission.track)]
        return SubmissionListView(items=of_track[: self.page_size], next_before=self.next_before)

    async def output(self, visitor: Visitor, submission_id: UUID, task: str | None, after: int) -> OutputView:
        tasks = (await self.submission(visitor, submission_id)).submission.tasks
        later = [item for item in self.printed if item.task == (task or tasks[0]) and item.episode > after]
        return OutputView(items=later[:2], next_after=later[1].episode if len(later) > 2 else None)

    async def receipts(self) -> ChainView:
        receipt = a_receipt()
        return ChainView(
            public_key=receipt.link.public_key, receipts=1, last=receipt.link.digest, items=[], next_after=None
        )

    async def receipt(self, visitor: Visitor, submission_id: UUID) -> Receipt:
        await self.submission(visitor, submission_id)
        return a_receipt()

    async def episode(self, visitor: Visitor | None, place: EpisodeAddress) -> ShownEpisodeView:
        await self.submission(visitor, place.submission_id)
        return self.shown_at(place)

    async def public_episode(self) -> PublicEpisodeView | None:
        return self.public_one

    async def announcements(self) -> list[AnnouncementView]:
        return self.said

    async def ask_for_playback(self, visitor: Visitor | None, place: EpisodeAddress, address: str) -> PlaybackView:
        await self.submission(visitor, place.submission_id)
        return self.ask_at(place)

    async def playback_file(self, visitor: Visitor | None, place: EpisodeAddress, file: PlaybackFile) -> bytes:
        await self.submission(visitor, place.submission_id)
        return self.file_at(place, file)

    async def sensor(self, visitor: Visitor, submission_id: UUID) -> ShownSensor:
        await self.submission(visitor, submission_id)
        if submission_id not in self.sensors:
            raise not_found("sensor of submission", submission_id)
        return self.sensors[submission_id]

    async def design_document(self, visitor: Visitor, submission_id: UUID) -> tuple[DocumentView, bytes]:
        return (await self.sensor(visitor, submission_id)).view.document, b"<script>"

    async def cancel(self, visitor: Visitor, submission_id: UUID) -> None:
        submission = (await self.submission(visitor, submission_id)).submission
        if submission.evaluation.finished_at is not None:
            raise ServiceError(ProblemCode.NOT_CANCELLABLE, "The evaluation has ended.")
        self.cancelled.append(submission_id)

    async def operations(self) -> OperationsView:
        return self.service

    async def sandboxes(self) -> list[SandboxDescription]:
        return self.described

    def server_disk(self) -> Disk:
        return Disk(total_bytes=200 << 30, free_bytes=50 << 30)

    def event_stream(self, visitor: Visitor) -> AbstractAsyncContextManager[None]:
        return nullcontext()

    async def upload(self, visitor: Visitor, announced: AnnouncedUpload, body: AsyncIterator[bytes]) -> UUID:
        content = b""
        async for piece in body:
            content += piece
            if content.startswith(b"broken"):
                raise ServiceError(ProblemCode.ARCHIVE_REJECTED, "The archive is <broken>. Pack it again.")
        self.uploaded.append((announced, content))
        return next(found.id for found in self.found if visitor.may_see(found.team.name))

    def archive_size(self) -> str:
        return "512 MiB"

    def log_size(self) -> str:
        return "32 MiB"

    def limits(self) -> list[LimitRow]:
        return [LimitRow(title="Processes and threads", value="64")]


def an_application(data: FixedData, tracks: tuple[str, ...] = ("track_1",)) -> FastAPI:
    """Pages over fixed content, as `vitac serve` mounts them."""
    app = FastAPI(docs_url=None, redoc_url=None)
    app.state.settings = load_settings(database_url="postgresql:///elsewhere")
    problems.install(app)
    routes.install(app, Site(data=data, signer=SIGNER, version="0.1.0", tracks=tracks))
    return app
