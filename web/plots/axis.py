"""Axes: where a value is drawn, and which values are written beside it. Called by the plots."""

from collections.abc import Callable
from dataclasses import dataclass
from math import ceil, floor, log10

from markupsafe import Markup

from .figure import element, joined

NICE = (1, 2, 2.5, 5, 10)
MAX_TICKS = 5


@dataclass(frozen=True, kw_only=True)
class Axis:
    """Values from `low` to `high`, drawn from `begin` to `end` [px]; `end` may lie before `begin`."""

    low: float
    high: float
    begin: float
    end: float
    is_whole: bool = False  # only whole numbers are written beside it

    def place(self, value: float) -> float:
        """Return where a value is drawn [px]; in the middle if the axis has one value only."""
        if self.high == self.low:
            return (self.begin + self.end) / 2
        return self.begin + (value - self.low) / (self.high - self.low) * (self.end - self.begin)

    def ticks(self) -> list[float]:
        """Return round values to write beside the axis."""
        span = self.high - self.low
        if span <= 0:
            return [self.low]
        magnitude = 10 ** floor(log10(span / MAX_TICKS))
        step = next(nice * magnitude for nice in NICE if span / (nice * magnitude) <= MAX_TICKS)
        if self.is_whole:
            step = ceil(step)
        first = ceil(self.low / step - 1e-9)
        return [round(number * step, 10) for number in range(first, floor(self.high / step + 1e-9) + 1)]


def below(axis: Axis, y: float, write: Callable[[float], str] = "{:g}".format) -> Markup:
    """Return a horizontal axis with its values below it."""
    line = element("line", class_="axis", x1=axis.begin, x2=axis.end, y1=y, y2=y)
    values = (
        element("text", write(tick), class_="tick", x=axis.place(tick), y=y + 16.0, text_anchor="middle")
        for tick in axis.ticks()
    )
    return line + joined(values)


def beside(axis: Axis, x: float, to: float, write: Callable[[float], str] = "{:g}".format) -> Markup:
    """Return the values of a vertical axis, each with a line across the plot from `x` to `to` [px]."""
    return joined(
        element("line", class_="grid", x1=x, x2=to, y1=axis.place(tick), y2=axis.place(tick))
        + element("text", write(tick), class_="tick", x=x - 8.0, y=axis.place(tick) + 4.0, text_anchor="end")
        for tick in axis.ticks()
    )
