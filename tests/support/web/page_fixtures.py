"""Views with made-up but consistent numbers, for tests of what draws, searches and pages them."""

import random
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from hashlib import sha256
from typing import Any
from uuid import UUID, uuid5

from vitac.evaluator.agent.description import SandboxDescription
from vitac.evaluator.logs.findings import VerificationResult
from vitac.evaluator.scoring.score import CombinedScore, Score, combine, rate
from vitac.evaluator.submission_kinds import SubmissionKind
from vitac.evaluator.tracks import ListKind, load_track
from vitac.server.database.states import EvaluationState
from vitac.server.evaluations.scores import played_score
from vitac.server.views.evaluations import (
    CopyView,
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
    TextLogEntryView,
)
from vitac.server.views.operations import WorkersView
from vitac.server.views.scores import PlayedScoreView, ShapeScoreView, TaskScoreView
from vitac.server.views.submissions import (
    EpisodeView,
    RankView,
    SubmissionView,
)
from vitac.server.views.teams import TeamView

NOW = datetime(2026, 11, 21, 3, 15, tzinfo=UTC)
WITHIN_TOLERANCE = VerificationResult.WITHIN_TOLERANCE
NAMESPACE = UUID("5ecf6a5e-8f3c-4b0e-9d5e-000000000000")
TASK = "peg-insertion"
LOCK = "lock-opening"
TASKS = load_track("track_1").tasks


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
        starts=whole.starts,
        successes=whole.successes,
        success_rate=whole.success_rate,
        success_rate_interval=(whole.interval.low, whole.interval.high),
        mean_steps=mean_steps,
        shapes=[
            ShapeScoreView(
                shape=shape,
                episodes=each,
                starts=part.starts,
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
    return combine(TASKS, _by_task(scores))


def played(scores: Sequence[TaskScoreView], counting: Sequence[str] = tuple(TASKS)) -> PlayedScoreView | None:
    """What they make of the tasks that were played."""
    return played_score(counting, _by_task(scores))


def _by_task(scores: Sequence[TaskScoreView]) -> dict[str, Score]:
    return {
        score.task: Score(
            **dict(rate(score.successes, score.episodes)), mean_steps=score.mean_steps, by_shape={}, outcomes={}
        )
        for score in scores
    }


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
        played=played(ranked),
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
        played=played(scores),
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
            initial_offset=episode.offset,
            outcome=outcome,
            success=outcome == "success",
            env_steps=chance.randint(3, 8),
        )
        for episode, outcome in zip(TASKS[task].episodes[:count], outcomes, strict=True)
    ]


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
        ranking_rule="Higher success rate first.",
        evaluator_version="1+0123456789ab",
        revision="c0ffee",
        generated_at=NOW,
        boards=[
            LogBoardView(
                kind=SubmissionKind.LOG,
                label=SubmissionKind.LOG.form.worth,
                task=name,
                title=task.title,
                entries=entries if name == TASK else [],
            )
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
        copy_of=CopyView(team="Gelbots", episodes=200, ranked=True) if team == "Bears" else None,
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
