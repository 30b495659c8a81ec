"""Marks of judges and what follows from them, as organizers see it."""

from uuid import UUID

from pydantic import Field

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
