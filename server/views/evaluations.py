"""Evaluations as they are shown: state, progress, verdict, score."""

from datetime import datetime
from uuid import UUID

from pydantic import Field

from ..db.states import EvaluationState
from .base import View
from .scores import TaskScoreView


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
