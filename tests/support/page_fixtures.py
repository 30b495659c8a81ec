"""Views with made-up but consistent numbers, and a service that answers the pages with them; imported by page tests."""

import random
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from uuid import UUID, uuid5

from fastapi import FastAPI
from vitac.evaluator.scoring import rate
from vitac.evaluator.tracks import load_track
from vitac.server.auth.principals import Principal
from vitac.server.db.states import EvaluationState, Role, SubmissionKind
from vitac.server.errors import ProblemCode, ServiceError, not_found
from vitac.server.views import (
    EpisodeView,
    EvaluationSummaryView,
    EvaluationView,
    LeaderboardEntryView,
    LeaderboardView,
    ProgressView,
    RankView,
    ShapeScoreView,
    SubmissionListView,
    SubmissionView,
    TaskProgressView,
    TaskScoreView,
    TeamView,
    VerdictView,
    WorkersView,
)
from vitac.web import pages
from vitac.web.page_data import LimitRow, Visitor
from vitac.web.session import SessionSigner
from vitac.web.site import Site

NOW = datetime(2026, 11, 21, 3, 15, tzinfo=UTC)
NAMESPACE = UUID("5ecf6a5e-8f3c-4b0e-9d5e-000000000000")
SHAPES = ("cuboid", "trapezoid", "concave1")
TASK = "peg-insertion"
SIGNER = SessionSigner(key=b"k" * 32)


def an_id(name: str) -> UUID:
    """The same id for the same name."""
    return uuid5(NAMESPACE, name)


def a_team(name: str) -> TeamView:
    """A team of that name."""
    return TeamView(id=an_id(name), name=name, created_at=NOW)


def a_score(successes: tuple[int, int, int], mean_steps: float | None) -> TaskScoreView:
    """A score with so many successes of 90 for each shape."""
    whole = rate(sum(successes), 270)
    shapes = [(shape, rate(count, 90)) for shape, count in zip(SHAPES, successes, strict=True)]
    return TaskScoreView(
        task=TASK,
        episodes=270,
        successes=whole.successes,
        success_rate=whole.success_rate,
        success_rate_interval=(whole.interval.low, whole.interval.high),
        mean_steps=mean_steps,
        shapes=[
            ShapeScoreView(
                shape=shape,
                episodes=90,
                successes=part.successes,
                success_rate=part.success_rate,
                success_rate_interval=(part.interval.low, part.interval.high),
            )
            for shape, part in shapes
        ],
        outcomes={"success": whole.successes, "tactile": 270 - whole.successes},
        result_hash="9f3b" * 16,
    )


def an_entry(
    rank: int | None, team: str, successes: tuple[int, int, int], mean_steps: float | None, name: str = "policy"
) -> LeaderboardEntryView:
    """A line of the leaderboard; without a rank it is from another evaluator version."""
    score = a_score(successes, mean_steps)
    return LeaderboardEntryView(
        rank=rank,
        stale=rank is None,
        team=team,
        submission_id=an_id(f"{team}/{name}"),
        submission_name=name,
        kind=SubmissionKind.MODEL,
        submitted_at=NOW - timedelta(hours=3),
        evaluated_at=NOW,
        episodes=score.episodes,
        successes=score.successes,
        success_rate=score.success_rate,
        success_rate_interval=score.success_rate_interval,
        mean_steps=mean_steps,
        scores=[score],
        result_hash=score.result_hash,
        evaluator_version="1+0123456789ab" if rank else "1+ba9876543210",
    )


def a_leaderboard(*entries: LeaderboardEntryView) -> LeaderboardView:
    """A leaderboard of Track 1."""
    track = load_track("track_1")
    return LeaderboardView(
        track=track.name,
        title=track.title,
        tasks=list(track.tasks),
        ranking_rule=track.ranking_rule,
        evaluator_version="1+0123456789ab",
        generated_at=NOW,
        teams=len(entries),
        entries=list(entries),
    )


def a_submission(
    team: str,
    state: EvaluationState,
    *,
    name: str = "policy",
    done: int = 0,
    workers: int = 1,
    verdict: VerdictView | None = None,
    log_tail: str = "",
    reused: int = 0,
) -> SubmissionView:
    """A submission whose evaluation is in a state; a completed one has all episodes and a score."""
    completed = state is EvaluationState.COMPLETED
    active = state in {EvaluationState.QUEUED, EvaluationState.RUNNING}
    done = 270 if completed else done
    scores = [a_score((80, 74, 80), 4.92)] if completed else []
    tasks = [TaskProgressView(task=TASK, episodes_done=done, episodes_total=270, successes=done // 2)]
    evaluation = EvaluationView(
        id=an_id(f"{team}/{name}/evaluation"),
        run=1,
        state=state,
        created_at=NOW,
        started_at=None if state is EvaluationState.QUEUED else NOW,
        finished_at=None if active else NOW + timedelta(seconds=54),
        queue_position=2 if state is EvaluationState.QUEUED else None,
        eta_s=41.0 if state is EvaluationState.RUNNING else None,
        progress=ProgressView(
            episodes_done=done, episodes_total=270, episodes_reused=reused, successes=done // 2, tasks=tasks
        ),
        verdict=verdict,
        log_tail=log_tail,
        result_hash=scores[0].result_hash if completed else None,
        success_rate=scores[0].success_rate if completed else None,
        mean_steps=scores[0].mean_steps if completed else None,
        scores=scores,
        evaluator_version="1+0123456789ab",
        evaluator_hash="01234567" * 8,
        platform_class="x86_64-linux",
        isolation=[] if state is EvaluationState.QUEUED else ["user-namespace, memory by cgroup-v2"],
    )
    return SubmissionView(
        id=an_id(f"{team}/{name}"),
        team=a_team(team),
        kind=SubmissionKind.MODEL,
        track="track_1",
        tasks=[TASK],
        name=name,
        digest="c0ffee00" * 8,
        archive_sha256="00" * 32,
        archive_bytes=1234,
        submitted_at=NOW,
        evaluation=evaluation,
        evaluations=[
            EvaluationSummaryView(
                id=evaluation.id,
                run=1,
                state=state,
                evaluator_version=evaluation.evaluator_version,
                created_at=NOW,
                finished_at=evaluation.finished_at,
                result_hash=evaluation.result_hash,
            )
        ],
        workers=WorkersView(alive=workers, last_heartbeat_at=NOW),
        rank=RankView(rank=2, of=4) if completed else None,
    )


def some_episodes(count: int) -> list[EpisodeView]:
    """The first episodes of the list, most of them successful."""
    chance = random.Random(3)  # noqa: S311 - made-up outcomes
    outcomes = chance.choices(["success", "tactile", "steps", "error"], [80, 10, 6, 2], k=count)
    return [
        EpisodeView(
            task=TASK,
            episode=episode.number,
            shape=episode.shape,
            outcome=outcome,
            success=outcome == "success",
            env_steps=chance.randint(3, 8),
        )
        for episode, outcome in zip(load_track("track_1").tasks[TASK].episodes[:count], outcomes, strict=True)
    ]


def a_visitor(name: str, role: Role = Role.TEAM) -> Visitor:
    """Somebody with a token of a team (or of the organizers)."""
    team = name if role is Role.TEAM else None
    principal = Principal(role=role, team_id=an_id(name) if team else None, team_name=team, token_id=an_id(f"t:{name}"))
    return Visitor(principal=principal, token_id=an_id(f"t:{name}"))


@dataclass(kw_only=True)
class FixedData:
    """A service with fixed content; tokens are `token-of-<name>`. Implements `PageData`."""

    visitors: list[Visitor] = field(default_factory=list)
    board: LeaderboardView = field(default_factory=a_leaderboard)
    found: list[SubmissionView] = field(default_factory=list)
    next_before: UUID | None = None
    cancelled: list[UUID] = field(default_factory=list)

    async def visitor_with_token(self, token: str) -> Visitor | None:
        return next((visitor for visitor in self.visitors if token == f"token-of-{visitor.name}"), None)

    async def visitor_with_token_id(self, token_id: UUID) -> Visitor | None:
        return next((visitor for visitor in self.visitors if visitor.token_id == token_id), None)

    async def leaderboard(self, track: str) -> LeaderboardView:
        return self.board

    async def submission(self, visitor: Visitor, submission_id: UUID) -> SubmissionView:
        for submission in self.found:
            if submission.id == submission_id and visitor.may_see(submission.team.name):
                return submission
        raise not_found("submission", submission_id)

    async def submissions(self, visitor: Visitor, before: UUID | None) -> SubmissionListView:
        seen = [submission for submission in self.found if visitor.may_see(submission.team.name)]
        return SubmissionListView(items=seen, next_before=self.next_before)

    async def episodes(self, visitor: Visitor, submission_id: UUID) -> list[EpisodeView]:
        return some_episodes((await self.submission(visitor, submission_id)).evaluation.progress.episodes_done)

    async def cancel(self, visitor: Visitor, submission_id: UUID) -> None:
        submission = await self.submission(visitor, submission_id)
        if submission.evaluation.finished_at is not None:
            raise ServiceError(ProblemCode.NOT_CANCELLABLE, "The evaluation has ended.")
        self.cancelled.append(submission_id)

    def limits(self) -> list[LimitRow]:
        return [LimitRow(title="Processes and threads", value="64")]


def an_application(data: FixedData) -> FastAPI:
    """Pages over fixed content, as `vitac serve` mounts them."""
    app = FastAPI(docs_url=None, redoc_url=None)
    pages.install(app, Site(data=data, signer=SIGNER, version="0.1.0", tracks=("track_1",)))
    return app
