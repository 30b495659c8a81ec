"""Marks of judges and what follows from them, as organizers see it."""

from datetime import datetime
from uuid import UUID

from pydantic import Field

from ..database.states import EvaluationState
from .base import View


class JudgedCriterionView(View):
    """What the judges think of one criterion."""

    criterion: str
    mean: float
    spread: float | None = Field(description="Standard deviation; null of fewer than two marks.")


class JudgedTeamView(View):
    """A team's best entry of a stage with its marks."""

    team: str
    submission: UUID
    success_rate: float
    judges: tuple[str, ...]
    conflicts: tuple[str, ...] = Field(description="Judges who do not judge this team.")
    set_aside: tuple[str, ...] = Field(
        description="Those of them who had given marks, before a merge of teams brought the conflict: not counted."
    )
    criteria: tuple[JudgedCriterionView, ...]
    mark: float | None = Field(description="Mean of the judges' means, from 0 to 10.")
    spread: float | None = Field(description="Standard deviation of these; null of fewer than two judges.")
    figures: float | None = Field(description="Share of the other sensors that it is better than; null: not measured.")
    total: float | None = Field(description="By the weights; null while something that it weighs is missing.")


class RejudgementView(View):
    """A rejudgement; it is open as long as it is neither applied nor discarded."""

    id: UUID
    competition: str | None = Field(default=None, description="Name of its competition; null outside of one.")
    track: str
    stage: str | None = Field(description="Of the competition; null outside of one.")
    reason: str
    started_at: datetime
    applied_at: datetime | None
    discarded_at: datetime | None


class StandingView(View):
    """What a submission reaches over all tasks of its track; without a score all but the verdict is null."""

    success_rate: float | None
    mean_steps: float | None
    rank: int | None = Field(description="Of its team's best entry, where it is that.")
    evaluator_version: str | None
    verdict: str | None = Field(description="Why there is no score.")


class RejudgedSubmissionView(View):
    """A submission before and after its rejudgement."""

    team: str
    submission: UUID
    name: str
    state: EvaluationState = Field(description="Of the new evaluation.")
    before: StandingView
    after: StandingView
    changes: bool = Field(description="Whether score or rank would be another one.")
    keeps_result: bool = Field(description="Whether it keeps its present result.")


class RejudgementDetailView(RejudgementView):
    """A rejudgement with its submissions, those that change first."""

    revision: str = Field(description="Give this as `shown` to apply exactly what is shown here.")
    submissions: list[RejudgedSubmissionView]
