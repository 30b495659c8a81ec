"""Success against each quantity that was drawn for every episode. Called by `pages.submissions.figures`."""

from __future__ import annotations

from typing import TYPE_CHECKING

from vitac.evaluator.scoring.comparison import rates_by_draw
from vitac.evaluator.tracks import load_track

from ..rendering import percent
from .axis import Axis, below, beside
from .figure import Figure, Table, element, joined

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
        found = [(end.draws[quantity.name], end.success) for end in ends if quantity.name in end.draws]
        if found:
            parts = rates_by_draw(quantity, definition.draws[quantity.name], found)
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
