"""What our example submissions reach on public lists, which boards show beside their entries without a rank.

The figures are those of `benchmarks/baselines.md` and of the examples' own pages, which a test compares.
"""

from dataclasses import dataclass
from statistics import fmean

from vitac.evaluator.scoring.score import interval_of_mean, rate
from vitac.evaluator.tracks import Track

from ..evaluations.scores import bounds
from ..views.leaderboards import BaselineView


@dataclass(frozen=True)
class _Figures:
    """Of an example in one task of a track."""

    track: str
    task: str
    name: str
    successes: int
    episodes: int
    mean_steps: float


_FIGURES = (
    _Figures("track_1", "peg-insertion", "peg_insertion_trained", 211, 270, 4.16),
    _Figures("track_1", "peg-insertion", "peg_insertion_heuristic", 40, 270, 4.40),
    _Figures("track_1", "lock-opening", "lock_opening_trained", 160, 160, 4.72),
    _Figures("track_1", "lock-opening", "lock_opening_heuristic", 160, 160, 6.25),
    _Figures("track_1", "lock-opening", "lock_opening_cloned", 101, 160, 6.35),
    _Figures("track_2", "fusion-insertion", "track_2_fusion", 150, 150, 23.80),
    _Figures("track_2_gt", "fusion-insertion-gt", "track_2_fusion", 150, 150, 23.80),
    _Figures("track_3", "sensor-standard", "track_3_dome", 26, 270, 4.19),
)
_COMBINED = {"track_1_heuristic": ("peg_insertion_heuristic", "lock_opening_heuristic")}
"""Examples of all tasks of a track, and those of single tasks that they are copies of."""


def list_baselines(track: Track, task: str | None) -> list[BaselineView]:
    """Return the baselines of a board on the public list of its track, the best first.

    Args:
        track: of the board.
        task: that it ranks; None: all tasks together.
    """
    if task is None and len(track.tasks) > 1:
        made = {name: [figures for figures in _FIGURES if figures.name in parts] for name, parts in _COMBINED.items()}
        return [_view(name, parts) for name, parts in made.items() if {part.track for part in parts} == {track.name}]
    shown = task or next(iter(track.tasks))
    return [_view(one.name, [one]) for one in _FIGURES if (one.track, one.task) == (track.name, shown)]


def _view(name: str, parts: list[_Figures]) -> BaselineView:
    rates = [rate(part.successes, part.episodes) for part in parts]
    interval = rates[0].interval if len(rates) == 1 else interval_of_mean(rates, of=len(rates))
    return BaselineView(
        name=name,
        episodes=sum(part.episodes for part in parts),
        successes=sum(part.successes for part in parts),
        success_rate=fmean(found.success_rate for found in rates),
        success_rate_interval=bounds(interval),
        mean_steps=fmean(part.mean_steps for part in parts),
    )
