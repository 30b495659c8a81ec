"""What our example submissions and people reach, which boards of public lists show beside their entries without a rank.

The examples' figures are those of `benchmarks/baselines.md` and of their own pages, which a test compares. People's are
published by an organizer, who has what they played.
"""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from statistics import fmean
from typing import Any, TypeAlias

from sqlalchemy.orm import Session
from vitac.evaluator.ranking import MEAN_STEPS, SUCCESS_RATE
from vitac.evaluator.scoring.score import Rate, average_shared, interval_of_mean, rate, rate_by_start
from vitac.evaluator.tracks import Track

from ..audit import record
from ..database.models import HumanBaseline
from ..errors import ProblemCode, ServiceError
from ..evaluations.scores import bounds
from ..principals import Principal
from ..tracks import load_known_track, require_task
from ..views.leaderboards import BaselineView
from ..views.scores import ShapeScoreView, TaskRateView


@dataclass(frozen=True)
class _Figures:
    """Of an example in one task of a track.

    Attributes:
        starts: by shape, of how many starts no repeat was solved, of how many one, and so on to all repeats.
        measures: means of what the task's boards rank by.
    """

    track: str
    task: str
    name: str
    starts: Mapping[str, tuple[int, ...]]
    mean_steps: float
    measures: Mapping[str, float] = field(default_factory=dict)

    def rate(self, shapes: Iterable[str]) -> Rate:
        """Return the successes with some of the shapes."""
        return rate_by_start(
            ((shape, solved, start), repeat < solved)
            for shape in shapes
            for solved, count in enumerate(self.starts[shape])
            for start in range(count)
            for repeat in range(len(self.starts[shape]) - 1)
        )


_ALL_LOCKS = dict.fromkeys(("key1", "key2", "key3", "key4"), (0, 0, 20))
_ALL_HOLES = {"hexagon": (0, 0, 0, 30), "cuboid": (0, 0, 0, 20)}
_FIGURES = (
    _Figures(
        "track_1",
        "peg-insertion",
        "peg_insertion_trained",
        {"cuboid": (2, 2, 5, 21), "trapezoid": (1, 4, 1, 24), "concave1": (4, 6, 8, 12)},
        4.16,
    ),
    _Figures(
        "track_1",
        "peg-insertion",
        "peg_insertion_heuristic",
        {"cuboid": (21, 6, 0, 3), "trapezoid": (19, 6, 3, 2), "concave1": (26, 1, 3, 0)},
        4.40,
    ),
    _Figures("track_1", "lock-opening", "lock_opening_trained", _ALL_LOCKS, 4.72),
    _Figures("track_1", "lock-opening", "lock_opening_heuristic", _ALL_LOCKS, 6.25),
    _Figures(
        "track_1",
        "lock-opening",
        "lock_opening_cloned",
        {"key1": (3, 6, 11), "key2": (3, 5, 12), "key3": (9, 3, 8), "key4": (6, 3, 11)},
        6.35,
    ),
    _Figures("track_2", "fusion-insertion", "track_2_fusion", _ALL_HOLES, 23.80),
    _Figures("track_2_gt", "fusion-insertion-gt", "track_2_fusion", _ALL_HOLES, 23.80),
    _Figures(
        "track_3",
        "sensor-standard",
        "track_3_dome",
        {"cuboid": (25, 1, 1, 3), "trapezoid": (23, 4, 3, 0), "concave1": (27, 2, 1, 0)},
        4.19,
    ),
    _Figures(
        "explore",
        "explore",
        "explore_scripted",
        {"bar": (9, 11), "beam": (6, 14), "corner": (8, 12), "cross": (6, 14), "frame": (4, 16), "square": (4, 16)},
        6.00,
        {"brier_score": 0.3006},
    ),
    _Figures(
        "in_hand_turn",
        "in-hand-turn",
        "in_hand_turn_scripted",
        {"narrow": (53, 7), "wide": (52, 8)},
        14.00,
        {"angle_error_deg": 3.1147},
    ),
    _Figures(
        "in_hand_turn",
        "in-hand-turn",
        "in_hand_turn_cloned",
        {"narrow": (32, 28), "wide": (41, 19)},
        14.00,
        {"angle_error_deg": 0.8838},
    ),
    _Figures(
        "slip",
        "slip",
        "slip_scripted",
        {"bar": (19, 21), "block": (17, 23), "column": (22, 18)},
        21.66,
        {"grip_force_n": 8.4394},
    ),
    _Figures(
        "slip",
        "slip",
        "slip_cloned",
        {"bar": (15, 25), "block": (19, 21), "column": (10, 30)},
        21.26,
        {"grip_force_n": 7.5364},
    ),
    _Figures(
        "soft_plug",
        "soft-plug",
        "soft_plug_scripted",
        {"slim": (17, 43), "stopper": (9, 51)},
        15.28,
        {"largest_bend_mm": 1.0652},
    ),
    _Figures(
        "soft_plug",
        "soft-plug",
        "soft_plug_cloned",
        {"slim": (17, 43), "stopper": (13, 47)},
        11.88,
        {"largest_bend_mm": 1.1044},
    ),
    _Figures("cable_end", "cable-end", "cable_end_scripted", {"cable": (36, 84)}, 14.64, {"largest_bend_mm": 1.1792}),
    _Figures("cable_end", "cable-end", "cable_end_cloned", {"cable": (71, 49)}, 10.82, {"largest_bend_mm": 1.8804}),
    _Figures(
        "assembly",
        "assembly",
        "assembly_scripted",
        {"narrow": (43, 17), "wide": (40, 20)},
        23.76,
        {"stages": 2.0417},
    ),
    _Figures(
        "assembly", "assembly", "assembly_cloned", {"narrow": (11, 49), "wide": (24, 36)}, 28.25, {"stages": 3.4917}
    ),
)
_COMBINED = {"track_1_heuristic": ("peg_insertion_heuristic", "lock_opening_heuristic")}
"""Examples of all tasks of a track, and those of single tasks that they are copies of."""


HUMAN = "human, by marker flow alone"
PlayedEpisode: TypeAlias = tuple[str, bool, int, dict[str, float]]
"""Shape, whether it was solved, its env steps, and what it has of what boards may rank by."""


def publish_human_baseline(
    session: Session, by: Principal, track: str, task: str, episodes: Sequence[PlayedEpisode]
) -> BaselineView:
    """Store what people played of a task by marker flow alone, in place of what was published of it before.

    Args:
        session: of the transaction.
        by: an organizer of the service.
        track: of the task.
        task: which one.
        episodes: all that were played, each with a start of its own.

    Raises:
        ServiceError: not an organizer, no such task, or a shape or measure that it does not have.
    """
    by.require_organizer()
    definition = require_task(load_known_track(track), task)
    measures = [measure.name for measure in definition.definition.measures if measure.better is not None]
    _require_known("shapes", task, definition.episode_list.shapes, {shape for shape, *_ in episodes})
    _require_known("measures", task, measures, {name for *_, values in episodes for name in values})
    row = session.get(HumanBaseline, (track, task))
    before = _summarize(row)
    if row is None:
        row = HumanBaseline(track=track, task=task)
        session.add(row)
    row.episodes, row.published_by = list(episodes), by.actor
    session.flush()
    record(session, by, "baseline.publish", f"task:{track}/{task}", _summarize(row) or {}, before=before)
    return _human_view(row)


def _require_known(what: str, task: str, known: Collection[str], got: Collection[str]) -> None:
    if strange := {*got} - {*known}:
        raise ServiceError(
            ProblemCode.INVALID_REQUEST,
            f"Expected {what} of {task} ({', '.join(known) or 'it has none'}), got {', '.join(sorted(strange))}.",
        )


def remove_human_baseline(session: Session, by: Principal, track: str, task: str) -> None:
    """Remove what people played of a task.

    Raises:
        ServiceError: not an organizer, no such task, or nothing is published of it.
    """
    by.require_organizer()
    require_task(load_known_track(track), task)
    row = session.get(HumanBaseline, (track, task))
    if row is None:
        raise ServiceError(ProblemCode.NOT_FOUND, f"No human baseline of {task} in {track} is published.")
    record(session, by, "baseline.remove", f"task:{track}/{task}", {}, before=_summarize(row))
    session.delete(row)


def _summarize(row: HumanBaseline | None) -> dict[str, int] | None:
    if row is None:
        return None
    return {"episodes": len(row.episodes), "successes": sum(solved for _, solved, *_ in row.episodes)}


def list_baselines(session: Session, track: Track, task: str | None) -> list[BaselineView]:
    """Return the baselines of a board on the public list of its track, the best first.

    Args:
        session: of the transaction.
        track: of the board.
        task: that it ranks; None: all tasks together.
    """
    shown = task or (next(iter(track.tasks)) if len(track.tasks) == 1 else None)
    human = session.get(HumanBaseline, (track.name, shown)) if shown else None
    views = [*list_examples(track, task), *([_human_view(human)] if human else [])]
    ranking = track.find_ranking(task)

    def place(view: BaselineView) -> tuple[float, ...]:
        usual = {SUCCESS_RATE.name: view.success_rate, MEAN_STEPS.name: view.mean_steps}
        return ranking.sort_key(view.measures | usual)

    return sorted(views, key=place)


def list_examples(track: Track, task: str | None) -> list[BaselineView]:
    """Return the baselines that are our example submissions."""
    if task is None and len(track.tasks) > 1:
        made = {name: [figures for figures in _FIGURES if figures.name in parts] for name, parts in _COMBINED.items()}
        return [_view(name, parts) for name, parts in made.items() if {part.track for part in parts} == {track.name}]
    shown = task or next(iter(track.tasks))
    return [_view(one.name, [one]) for one in _FIGURES if (one.track, one.task) == (track.name, shown)]


def _human_view(row: HumanBaseline) -> BaselineView:
    steps = [env_steps for _, solved, env_steps, _ in row.episodes if solved]
    mean_steps = fmean(steps) if steps else None
    whole = _compute_rate(row.episodes)
    shapes = {shape: [one for one in row.episodes if one[0] == shape] for shape, *_ in row.episodes}
    score = TaskRateView(
        task=row.task,
        mean_steps=mean_steps,
        shapes=[ShapeScoreView(shape=shape, **_columns(_compute_rate(of_shape))) for shape, of_shape in shapes.items()],
        **_columns(whole),
    )
    return BaselineView(
        name=HUMAN,
        is_human=True,
        episodes=whole.episodes,
        successes=whole.successes,
        success_rate=whole.success_rate,
        success_rate_interval=bounds(whole.interval),
        mean_steps=mean_steps,
        measures=average_shared([measures for *_, measures in row.episodes]),
        scores=[score],
    )


def _compute_rate(episodes: Sequence[PlayedEpisode]) -> Rate:
    return rate(sum(solved for _, solved, *_ in episodes), len(episodes))


def _view(name: str, parts: list[_Figures]) -> BaselineView:
    rates = [part.rate(part.starts) for part in parts]
    interval = rates[0].interval if len(rates) == 1 else interval_of_mean(rates, of=len(rates))
    return BaselineView(
        name=name,
        episodes=sum(rate.episodes for rate in rates),
        successes=sum(rate.successes for rate in rates),
        success_rate=fmean(rate.success_rate for rate in rates),
        success_rate_interval=bounds(interval),
        mean_steps=fmean(part.mean_steps for part in parts),
        measures=dict(parts[0].measures) if len(parts) == 1 else {},
        scores=[_score(part) for part in parts],
    )


def _score(figures: _Figures) -> TaskRateView:
    return TaskRateView(
        task=figures.task,
        mean_steps=figures.mean_steps,
        shapes=[ShapeScoreView(shape=shape, **_columns(figures.rate([shape]))) for shape in figures.starts],
        **_columns(figures.rate(figures.starts)),
    )


def _columns(counted: Rate) -> dict[str, Any]:
    return counted.model_dump(exclude={"interval"}) | {"success_rate_interval": bounds(counted.interval)}
