"""Success against each quantity that was drawn for every episode. Called by `pages.submissions.figures`."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import median
from typing import TYPE_CHECKING

from markupsafe import Markup
from vitac.evaluator.episodes.records import ContactForces, ForceFigures
from vitac.evaluator.scoring.comparison import rates_by_draw
from vitac.evaluator.scoring.score import summarize_forces
from vitac.evaluator.scoring.starts import find_start
from vitac.evaluator.tracks import load_track
from vitac.server.views.submissions import EpisodeView

from ..rendering import percent
from .axis import Axis, Figure, Table, below, beside, element, joined

if TYPE_CHECKING:
    from collections.abc import Sequence

    from markupsafe import Markup
    from vitac.envs.tasks.quantities import Quantity
    from vitac.evaluator.scoring.comparison import RateOfPart
    from vitac.server.views.submissions import EpisodeView

_WIDTH, _HEIGHT = 300, 190


def success_by_draw(track: str, task: str, ends: Sequence[EpisodeView]) -> list[Figure]:
    """Return a plot for each drawn quantity; none of a task that draws nothing, or that the track has no longer.

    Args:
        track: name of the track.
        task: its task.
        ends: its finished episodes.
    """
    definition = load_track(track).tasks.get(task)
    if definition is None:
        return []
    figures = []
    for quantity in definition.drawn_quantities:
        drawn = [(end.draws[quantity.name], find_start(end), end.success) for end in ends if quantity.name in end.draws]
        if drawn:
            parts = rates_by_draw(quantity, definition.draws[quantity.name], drawn)
            figures.append(_figure(task, quantity, parts))
    return figures


def _figure(task: str, quantity: Quantity, parts: Sequence[RateOfPart]) -> Figure:
    x = Axis(low=parts[0].low, high=parts[-1].high, begin=52.0, end=_WIDTH - 12.0)
    y = Axis(low=0.0, high=1.0, begin=_HEIGHT - 34.0, end=12.0)
    label = f"{quantity.label}, distance from {quantity.nominal:g}" if quantity.two_sided else quantity.label
    return Figure(
        key=f"draws-{task}-{quantity.name}",
        title=label,
        summary=f"Success by {label}: " + ", ".join(percent(part.rate.success_rate) for part in parts),
        width=_WIDTH,
        height=_HEIGHT,
        drawing=beside(y, x.begin - 8.0, x.end, lambda value: f"{100 * value:g} %")
        + joined(_drawn(part, x, y) for part in parts)
        + below(x, y.begin + 4.0),
        table=Table(
            columns=(label, "Solved", "Success rate", "95 % interval"),
            rows=tuple(
                (
                    f"{part.low:g} to {part.high:g}",
                    f"{part.rate.successes} of {part.rate.episodes}",
                    percent(part.rate.success_rate),
                    f"{percent(part.rate.interval.low)} to {percent(part.rate.interval.high)}",
                )
                for part in parts
            ),
        ),
    )


def _drawn(part: RateOfPart, x: Axis, y: Axis) -> Markup:
    """Return the rate of a part over its width, with the interval as a band."""
    left, right = x.place(part.low) + 2.0, x.place(part.high) - 2.0
    low, high = y.place(part.rate.interval.low), y.place(part.rate.interval.high)
    at = y.place(part.rate.success_rate)
    return element("rect", class_="band", x=left, y=high, width=right - left, height=low - high, rx=2) + element(
        "circle", class_="point", cx=(left + right) / 2, cy=at, r=5
    )


_FORCES_WIDTH, _ROW, _LEFT = 600, 46, 96.0


def peak_forces(task: str, ends: Sequence[EpisodeView]) -> Figure | None:
    """Return a plot with a dot for each episode, and a table of the medians; None where no forces are recorded.

    Args:
        task: what was played.
        ends: its finished episodes.
    """
    groups = {"Solved": _forces(ends, success=True), "Not solved": _forces(ends, success=False)}
    shown = {name: forces for name, forces in groups.items() if forces}
    if not shown:
        return None
    everything = [each for forces in shown.values() for each in forces]
    threshold_n = everything[0].over_force_n
    x = Axis(
        low=0.0,
        high=max(threshold_n, *(each.part.peak_n for each in everything)),
        begin=_LEFT,
        end=_FORCES_WIDTH - 16.0,
    )
    bottom = _ROW * len(shown) + 8.0
    limit = element("line", class_="threshold", x1=x.place(threshold_n), x2=x.place(threshold_n), y1=4.0, y2=bottom)
    rows = joined(_row(name, forces, number, x) for number, (name, forces) in enumerate(shown.items()))
    medians = ", ".join(f"{name.lower()} {_peak_n(forces):.1f} N" for name, forces in shown.items())
    return Figure(
        key=f"forces-{task}",
        title="Largest force on the held part",
        summary=f"Largest force on the held part, medians of episodes: {medians}. Dashed: {threshold_n:g} N.",
        width=_FORCES_WIDTH,
        height=round(bottom) + 24,
        drawing=limit + rows + below(x, bottom, "{:g} N".format),
        table=_table(shown, everything),
    )


def _forces(ends: Sequence[EpisodeView], *, success: bool) -> list[ContactForces]:
    return [end.forces for end in ends if end.forces is not None and end.success is success]


def _peak_n(forces: Sequence[ContactForces]) -> float:
    return median(each.part.peak_n for each in forces)


def _row(name: str, forces: Sequence[ContactForces], number: int, x: Axis) -> Markup:
    """Return the dots of a group, one below the other where they would cover each other, and its median as a bar."""
    middle = _ROW * number + _ROW / 2
    at = x.place(_peak_n(forces))
    dots = joined(
        element(
            "circle", class_="point faint", cx=x.place(each.part.peak_n), cy=middle - 12.0 + 6.0 * (place % 5), r=2.5
        )
        for place, each in enumerate(sorted(forces, key=lambda each: each.part.peak_n))
    )
    bar = element("line", class_="median", x1=at, x2=at, y1=middle - 18.0, y2=middle + 18.0)
    return element("text", name, class_="label", x=0, y=middle + 4.0) + dots + bar


def _table(shown: dict[str, list[ContactForces]], everything: Sequence[ContactForces]) -> Table:
    groups = {f"On the held part, {name.lower()}": summarize_forces(forces) for name, forces in shown.items()}
    whole = summarize_forces(everything)
    assert whole is not None  # noqa: S101 - there is an episode
    above = f"{whole.over_force_events} times above {whole.over_force_n:g} N on the held part"
    rows = [
        *((name, *_figures(ends.episodes, ends.part)) for name, ends in groups.items() if ends is not None),
        *([("On the more loaded gel", *_figures(whole.episodes, whole.gel))] if whole.gel else []),
        (above, f"{whole.over_force_episodes}", "", "", ""),
        *([_describe_stretch(whole.largest_stretch, whole.episodes)] if whole.largest_stretch else []),
    ]
    columns = ("Medians of the episodes", "Episodes", "Peak [N]", "95th percentile [N]", "Impulse [N s]")
    return Table(columns=columns, rows=tuple(rows))


def _describe_stretch(largest: float, episodes: int) -> tuple[str, ...]:
    return f"Largest stretch of a gel: {largest:.2f}", f"{episodes}", "", "", ""


def _figures(episodes: int, forces: ForceFigures) -> tuple[str, ...]:
    return f"{episodes}", f"{forces.peak_n:.1f}", f"{forces.p95_n:.1f}", f"{forces.impulse_n_s:.1f}"
