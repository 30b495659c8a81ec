"""What the REST API answers and the pages show; made by the service layer, never changed afterwards."""

from datetime import datetime
from typing import Any
from uuid import UUID

from pydantic import BaseModel, ConfigDict, Field
from vitac.evaluator.logs.findings import VerificationResult
from vitac.server.db.states import EvaluationState, Role, SubmissionKind


class View(BaseModel):
    """Base of all answers: frozen, nothing beyond the fields."""

    model_config = ConfigDict(frozen=True, extra="forbid")


class TeamView(View):
    """A team."""

    id: UUID
    name: str
    created_at: datetime


class TokenView(View):
    """A token without its secret."""

    id: UUID
    label: str
    role: Role
    team: str | None
    created_at: datetime
    expires_at: datetime | None
    revoked_at: datetime | None
    last_used_at: datetime | None


class NewTokenView(TokenView):
    """A new token; the secret is shown this once and stored as a hash only."""

    secret: str


class RegisteredTeamView(View):
    """A new team with its first token."""

    team: TeamView
    token: NewTokenView


class MeView(View):
    """Who the token belongs to."""

    role: Role
    team: TeamView | None
    token: TokenView | None


class ShapeScoreView(View):
    """Successes with one shape."""

    shape: str
    episodes: int
    successes: int
    success_rate: float
    success_rate_interval: tuple[float, float] = Field(description="Wilson score interval, 95 %.")


class TaskScoreView(View):
    """Score of one task."""

    task: str
    episodes: int
    successes: int
    success_rate: float
    success_rate_interval: tuple[float, float] = Field(description="Wilson score interval, 95 %.")
    mean_steps: float | None = Field(description="Mean env steps of the successful episodes; null without a success.")
    shapes: list[ShapeScoreView]
    outcomes: dict[str, int] = Field(description="How many episodes ended in which way.")
    result_hash: str = Field(description="The hash that `vitac evaluate` prints for the same evaluation.")


class TaskProgressView(View):
    """Finished episodes of one task."""

    task: str
    episodes_done: int
    episodes_total: int
    successes: int


class ProgressView(View):
    """Finished episodes of an evaluation."""

    episodes_done: int
    episodes_total: int
    episodes_reused: int = Field(
        description="Of the finished ones: those that were stored before this evaluation began."
    )
    successes: int
    tasks: list[TaskProgressView]


class VerdictView(View):
    """Why an evaluation has no score."""

    code: str = Field(description="Stable name, from a closed list.")
    title: str = Field(description="What this code means and what to do about it.")
    message: str = Field(description="What happened this time.")
    task: str | None
    episode: int | None


class EvaluationSummaryView(View):
    """A line of a submission's history."""

    id: UUID
    run: int
    state: EvaluationState
    evaluator_version: str
    created_at: datetime
    finished_at: datetime | None
    result_hash: str | None


class EvaluationView(EvaluationSummaryView):
    """One run of the evaluator over a submission."""

    started_at: datetime | None
    queue_position: int | None = Field(description="1 is next; null unless queued.")
    eta_s: float | None = Field(description="Seconds to the end; null when finished or not known.")
    progress: ProgressView
    verdict: VerdictView | None
    log_tail: str = Field(description="The end of what the policy printed in episodes that it failed in.")
    success_rate: float | None = Field(description="Mean over all tasks of the track; a task not played counts as 0.")
    success_rate_interval: tuple[float, float] | None = Field(description="Of that mean, 95 %.")
    mean_steps: float | None = Field(description="Mean of all tasks' mean steps; null where a task has none.")
    scores: list[TaskScoreView]
    evaluator_hash: str
    platform_class: str | None
    isolation: list[str] = Field(description="How the policy was isolated, on each kind of worker machine.")


class WorkersView(View):
    """Whether anybody works on evaluations."""

    alive: int
    last_heartbeat_at: datetime | None


class DivergenceView(View):
    """The first env step at which a log's actions led elsewhere; step 0 is after the reset."""

    episode: int
    env_step: int
    recorded_state: str | None = Field(description="SHA-256 of the state, as the log has it.")
    recorded_info: dict[str, Any] | None = Field(description="What the log tells of that env step, in our form.")
    resimulated_state: str | None
    resimulated_info: dict[str, Any] | None


class LogView(View):
    """What an uploaded log claims, and what its re-simulation says of it."""

    label: str = Field(description="What a score of it is worth, in a few words.")
    verdict: VerificationResult | None = Field(description="Null before the end, and always for a 2025 text log.")
    reason: str | None = Field(description="The verdict in a sentence.")
    divergence: DivergenceView | None
    claimed_episodes: int
    claimed_successes: int
    claimed_success_rate: float
    claimed_mean_steps: float | None
    claimed_result_hash: str | None = Field(description="Follows from the log's records; null for a 2025 text log.")
    team_named: str | None
    submission_digest_named: str | None = Field(description="Digest of the model that the log says it is of.")
    made_on: str | None = Field(description="Platform class that the log says it was made on.")
    problems: list[str] = Field(description="Numbers of a 2025 text log that do not follow from each other.")


class AuditedEpisodeView(View):
    """How far a model's own episode went along with the log's."""

    episode: int
    actions: int
    reproduced: int
    first_mismatch: int | None = Field(description="Env step of the first other action; null if there is none.")


class AuditView(View):
    """How many of a log's actions a model that the team uploaded gives.

    Both were played from the same starts. Up to the first other action of an episode both saw the same; what comes
    after it cannot be compared, so it counts as not reproduced.
    """

    submission_id: UUID
    submission_name: str
    evaluated_at: datetime
    actions: int
    reproduced: int
    episodes: int
    episodes_reproduced: int
    others: list[AuditedEpisodeView] = Field(description="The episodes with an other action.")


class RankView(View):
    """Place on a leaderboard of the team's best entry there, when it is this submission."""

    rank: int
    of: int


class SubmissionView(View):
    """One upload and its newest evaluation."""

    id: UUID
    team: TeamView
    kind: SubmissionKind
    track: str
    tasks: list[str]
    missing_tasks: list[str] = Field(description="Tasks of the track that a model does not play; each counts as 0.")
    name: str
    digest: str = Field(description="SHA-256 of the content; equal for a folder and its zip, a log and its gzip.")
    archive_sha256: str
    archive_bytes: int
    submitted_at: datetime
    evaluation: EvaluationView
    evaluations: list[EvaluationSummaryView] = Field(description="All runs, newest first.")
    workers: WorkersView
    rank: RankView | None = Field(description="On the leaderboard of all tasks together.")
    task_ranks: dict[str, RankView] = Field(description="On the leaderboards of single tasks.")
    log: LogView | None = Field(description="Null for a model.")


class SubmissionListView(View):
    """A page of submissions, newest first."""

    items: list[SubmissionView]
    next_before: UUID | None = Field(description="Give this as `before` for the next page; null on the last one.")


class EpisodeView(View):
    """How one episode ended."""

    task: str
    episode: int
    shape: str
    outcome: str
    success: bool
    env_steps: int


class LeaderboardEntryView(View):
    """Best entry of one team."""

    rank: int | None = Field(description="Null for an entry that another evaluator version made: it is not comparable.")
    stale: bool
    team: str
    submission_id: UUID
    submission_name: str
    kind: SubmissionKind
    submitted_at: datetime
    evaluated_at: datetime
    episodes: int
    successes: int
    success_rate: float = Field(description="Of the task; without one the mean over all tasks, one not played being 0.")
    success_rate_interval: tuple[float, float] = Field(description="95 % interval of that.")
    mean_steps: float | None = Field(
        description="Of the task, or the mean of all tasks' means; null where one is missing."
    )
    scores: list[TaskScoreView] = Field(description="Of the tasks that it plays and this leaderboard ranks.")
    result_hash: str
    evaluator_version: str


class LeaderboardView(View):
    """Standings of one track, or of one of its tasks."""

    track: str
    title: str
    tasks: list[str] = Field(description="All tasks of the track.")
    task: str | None = Field(description="The task that is ranked; null: all together.")
    ranking_rule: str
    evaluator_version: str
    generated_at: datetime
    teams: int
    entries: list[LeaderboardEntryView]


class LogEntryView(View):
    """Best verified log of one team for one task."""

    rank: int | None = Field(description="Null for an entry that another evaluator version made: it is not comparable.")
    stale: bool
    team: str
    submission_id: UUID
    submission_name: str
    verdict: VerificationResult
    submitted_at: datetime
    episodes: int
    successes: int
    success_rate: float
    success_rate_interval: tuple[float, float]
    mean_steps: float | None
    result_hash: str
    evaluator_version: str


class LogBoardView(View):
    """Verified logs of one task, ranked among themselves."""

    task: str
    title: str
    entries: list[LogEntryView]


class TextLogEntryView(View):
    """A 2025 text log: what it claims, and what our physics makes of its actions. Not ranked."""

    team: str
    task: str
    submission_id: UUID
    submission_name: str
    submitted_at: datetime
    claimed_success_rate: float
    claimed_mean_steps: float | None
    success_rate: float
    mean_steps: float | None
    problems: int
    evaluator_version: str


class LogBoardsView(View):
    """All logs of a track, apart from the evaluated models."""

    track: str
    title: str
    label: str
    ranking_rule: str
    evaluator_version: str
    generated_at: datetime
    boards: list[LogBoardView]
    text_logs: list[TextLogEntryView]


class TrackTaskView(View):
    """One task of a track."""

    name: str
    title: str
    env_id: str
    episodes: int
    max_steps: int


class TrackView(View):
    """A track that can be submitted to."""

    name: str
    title: str
    summary: str
    ranking_rule: str = Field(description="Order on the leaderboard of a task.")
    combination_rule: str | None = Field(description="Order on the leaderboard of all tasks; null where there is one.")
    accepts: list[SubmissionKind] = Field(description="What may be submitted.")
    tasks: list[TrackTaskView]
    log_bytes: int = Field(description="Largest log that may be uploaded, packed and unpacked.")
    limits: dict[str, float] = Field(description="Most that an upload and its policy may use; bytes, seconds, numbers.")


class TrackListView(View):
    """All tracks."""

    items: list[TrackView]


class TokenListView(View):
    """Tokens of a team, or all for an organizer."""

    items: list[TokenView]


class HealthView(View):
    """The process answers."""

    status: str
    version: str


class ReadyView(View):
    """Whether the service can do its work, part by part: `ok` or what is wrong."""

    status: str
    database: str
    migrations: str
    storage: str
    workers: WorkersView | None


class ProblemView(BaseModel):
    """RFC 9457 problem; `code` is stable, further members depend on it."""

    model_config = ConfigDict(extra="allow")

    type: str
    title: str
    status: int
    detail: str
    code: str
    instance: str
    errors: list[dict[str, Any]] | None = None
