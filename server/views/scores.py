"""Scores of tasks as they are shown."""

from collections import Counter
from collections.abc import Iterable

from pydantic import Field
from vitac.evaluator.scoring.score import ForceSummary

from .base import View

STARTS = "Number of different starts among the episodes; the others repeat one."
INTERVAL = (
    "95 % interval: Wilson's, of as many independent episodes as these starts with their repeats tell as much as."
)


class RateView(View):
    """Successes among some episodes."""

    episodes: int
    starts: int = Field(description=STARTS)
    successes: int
    success_rate: float
    success_rate_interval: tuple[float, float] = Field(description=INTERVAL)


class ShapeScoreView(RateView):
    """Successes with one shape."""

    shape: str


class TaskRateView(RateView):
    """Success rate in one task, also by shape."""

    task: str
    mean_steps: float | None = Field(description="Mean env steps of the successful episodes; null without a success.")
    shapes: list[ShapeScoreView]


class TaskScoreView(TaskRateView):
    """Score of one task."""

    outcomes: dict[str, int] = Field(description="How many episodes ended in which way.")
    forces: ForceSummary | None = Field(
        default=None, description="Contact forces, medians over the episodes; null where none are recorded."
    )
    measures: dict[str, float] = Field(
        default={}, description="Means over the episodes of what boards may rank by, by its name."
    )
    twins: dict[str, int] = Field(
        default={},
        description="How many of the episodes were played on a twin, no hardware, by the twin's kind in words.",
    )
    result_hash: str = Field(description="The hash that `vitac evaluate` prints for the same evaluation.")


def describe_twins(scores: Iterable[TaskScoreView]) -> str:
    """Say how many trials were played on twins; nothing where none was."""
    twins, trials = Counter[str](), 0
    for score in scores:
        twins.update(score.twins)
        trials += score.episodes
    played = [f"{count} of {trials} trials on {twin}" for twin, count in sorted(twins.items())]
    return f"Played on twins: {'; '.join(played)}." if played else ""


class PlayedScoreView(View):
    """What was reached in the tasks that were played, of those that count: what a result is headed with."""

    tasks: list[str]
    episodes: int
    starts: int = Field(description=STARTS)
    successes: int
    success_rate: float = Field(description="Mean over these tasks.")
    success_rate_interval: tuple[float, float] = Field(description="95 % interval of that.")
    mean_steps: float | None = Field(description="Mean of these tasks' means; null where one has no success.")


class PracticeScoreView(TaskScoreView):
    """Score of one task on the public list, which was played beside the sealed one and does not rank."""

    p_value: float = Field(
        description="How likely a difference to the sealed list at least as large as this one, in favour of the public "
        "list, is if the policy is equally good on both: exact permutation test over the starts."
    )
    sentence: str = Field(description="Both results compared, in words.")
