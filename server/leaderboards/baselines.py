"""What our example submissions reach on public lists, which boards show beside their entries without a rank.

The figures are those of `benchmarks/baselines.md` and of the examples' own pages, which a test compares.
"""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from statistics import fmean
from typing import Any

from vitac.evaluator.scoring.score import Rate, interval_of_mean, rate
from vitac.evaluator.tracks import Track

from ..evaluations.scores import bounds
from ..views.leaderboards import BaselineView
from ..views.scores import ShapeScoreView, TaskRateView


@dataclass(frozen=True)
class _Figures:
    """Of an example in one task of a track."""

    track: str
    task: str
    name: str
    successes: Mapping[str, int]  # by shape
    mean_steps: float


_ALL_LOCKS = {"key1": 40, "key2": 40, "key3": 40, "key4": 40}
_ALL_HOLES = {"hexagon": 90, "cuboid": 60}
_FIGURES = (
    _Figures(
        "track_1", "peg-insertion", "peg_insertion_trained", {"cuboid": 75, "trapezoid": 78, "concave1": 58}, 4.16
    ),
    _Figures(
        "track_1", "peg-insertion", "peg_insertion_heuristic", {"cuboid": 15, "trapezoid": 18, "concave1": 7}, 4.40
    ),
    _Figures("track_1", "lock-opening", "lock_opening_trained", _ALL_LOCKS, 4.72),
    _Figures("track_1", "lock-opening", "lock_opening_heuristic", _ALL_LOCKS, 6.25),
    _Figures("track_1", "lock-opening", "lock_opening_cloned", {"key1": 28, "key2": 29, "key3": 19, "key4": 25}, 6.35),
    _Figures("track_2", "fusion-insertion", "track_2_fusion", _ALL_HOLES, 23.80),
    _Figures("track_2_gt", "fusion-insertion-gt", "track_2_fusion", _ALL_HOLES, 23.80),
    _Figures("track_3", "sensor-standard", "track_3_dome", {"cuboid": 12, "trapezoid": 10, "concave1": 4}, 4.19),
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
        return [
            _view(name, track, parts) for name, parts in made.items() if {part.track for part in parts} == {track.name}
        ]
    shown = task or next(iter(track.tasks))
    return [_view(one.name, track, [one]) for one in _FIGURES if (one.track, one.task) == (track.name, shown)]


def _view(name: str, track: Track, parts: list[_Figures]) -> BaselineView:
    scores = [_score(track, part) for part in parts]
    rates = [rate(score.successes, score.episodes) for score in scores]
    interval = rates[0].interval if len(rates) == 1 else interval_of_mean(rates, of=len(rates))
    return BaselineView(
        name=name,
        episodes=sum(score.episodes for score in scores),
        successes=sum(score.successes for score in scores),
        success_rate=fmean(found.success_rate for found in rates),
        success_rate_interval=bounds(interval),
        mean_steps=fmean(part.mean_steps for part in parts),
        scores=scores,
    )


def _score(track: Track, figures: _Figures) -> TaskRateView:
    played = Counter(start.shape for start in track.tasks[figures.task].episode_list.starts)
    shapes = {shape: rate(successes, played[shape]) for shape, successes in figures.successes.items()}
    return TaskRateView(
        task=figures.task,
        mean_steps=figures.mean_steps,
        shapes=[ShapeScoreView(shape=shape, **_columns(found)) for shape, found in shapes.items()],
        **_columns(rate(sum(figures.successes.values()), played.total())),
    )


def _columns(found: Rate) -> dict[str, Any]:
    return found.model_dump(exclude={"interval"}) | {"success_rate_interval": bounds(found.interval)}
