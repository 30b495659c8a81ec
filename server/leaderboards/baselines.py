"""What our example submissions reach on public lists, which boards show beside their entries without a rank.

The figures are those of `benchmarks/baselines.md`, which a test compares.
"""

from vitac.evaluator.scoring.score import rate

from ..evaluations.scores import bounds
from ..views.leaderboards import BaselineView

_FIGURES = (
    ("peg-insertion", "peg_insertion_trained", 211, 270, 4.16),
    ("peg-insertion", "peg_insertion_heuristic", 40, 270, 4.40),
    ("lock-opening", "lock_opening_trained", 160, 160, 4.72),
    ("lock-opening", "lock_opening_heuristic", 160, 160, 6.25),
)
"""Task of Track 1, folder of the example, successes, episodes, mean env steps of the successes."""


def list_baselines(track: str, task: str | None) -> list[BaselineView]:
    """Return the baselines of a task on the public list of its track, the best first; none for all tasks together."""
    return [_view(*figures[1:]) for figures in _FIGURES if (track, task) == ("track_1", figures[0])]


def _view(name: str, successes: int, episodes: int, mean_steps: float) -> BaselineView:
    found = rate(successes, episodes)
    return BaselineView(
        name=name,
        episodes=episodes,
        successes=successes,
        success_rate=found.success_rate,
        success_rate_interval=bounds(found.interval),
        mean_steps=mean_steps,
    )
