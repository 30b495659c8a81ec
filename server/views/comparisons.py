"""Results beside each other, as API, pages and commands show them."""

from datetime import datetime
from uuid import UUID

from pydantic import Field

from .base import View
from .scores import PlayedScoreView, TaskScoreView


class ComparedResultView(View):
    """One of the results that are compared."""

    submission_id: UUID
    submission_name: str
    team: str
    track: str
    submitted_at: datetime
    evaluator_version: str
    played: PlayedScoreView | None
    scores: list[TaskScoreView]
    has_page: bool = Field(description="The reader may see its submission; of others only what a leaderboard shows.")
    episodes: int = Field(description="Number of single episodes that the reader may see; 0 where none are shown.")


class RateView(View):
    """Successes among some episodes."""

    episodes: int
    successes: int
    success_rate: float
    success_rate_interval: tuple[float, float] = Field(description="Wilson score interval, 95 %.")


class ComparedGroupView(View):
    """The same episodes of a task as all results played them."""

    task: str
    name: str = Field(description="The shape, or how far from their targets these episodes start.")
    is_shape: bool
    rates: list[RateView | None] = Field(description="In the order of the results; null where it is not known.")


class ComparedPairView(View):
    """Two of the results, on the episodes that both have: exact McNemar test."""

    first: int = Field(description="Place in the list of results, from 0.")
    second: int
    both: int
    only_first: int
    only_second: int
    neither: int
    unpaired: int = Field(description="Episodes that only one of them has, which are left out.")
    p_value: float = Field(
        description="How likely a difference at least as large is if both are equally good; of several pairs, one in "
        "twenty is below 0.05 by chance."
    )


class ComparedEndView(View):
    """How an episode ended in one of the results."""

    outcome: str
    success: bool
    env_steps: int


class ComparedEpisodeView(View):
    """An episode that some of the results solve and others do not."""

    task: str
    episode: int
    shape: str
    ends: list[ComparedEndView | None] = Field(description="In the order of the results; null where it is not shown.")


class ComparisonView(View):
    """Results beside each other: by shape, by difficulty, in pairs, and the episodes in which they differ."""

    results: list[ComparedResultView]
    groups: list[ComparedGroupView]
    pairs: list[ComparedPairView]
    differing: list[ComparedEpisodeView]
