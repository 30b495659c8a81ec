"""Axes: where a value is drawn, and which values are written beside it. Called by the plots."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cached_property
from math import ceil, floor, log10

from markupsafe import Markup


@dataclass(frozen=True, kw_only=True)
class Table:
    """What a plot shows, in words and numbers; the first cell of each row names it."""

    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]

    @cached_property
    def body(self) -> Markup:
        """Its rows as HTML, made once: those of a board have a thousand cells, and stay as long as its plot."""
        cell, row = Markup("<td>{}</td>"), Markup('<tr><th scope="row">{}</th>{}</tr>\n')
        return Markup("").join(row.format(name, Markup("").join(map(cell.format, cells))) for name, *cells in self.rows)


@dataclass(frozen=True, kw_only=True)
class Figure:
    """A plot.

    Attributes:
        key: id of the plot on its page.
        title: what is drawn.
        summary: what it shows, in a sentence, for whoever does not see it.
        width: of the drawing [px].
        height: of the drawing [px].
        drawing: its SVG elements.
        table: what it shows.
    """

    key: str
    title: str
    summary: str
    width: int
    height: int
    drawing: Markup
    table: Table


def element(name: str, content: str | Markup = "", **attributes: object) -> Markup:
    """Return an SVG element; names of attributes have `_` for `-`, and `class_` stands for `class`."""
    written = Markup("").join(
        Markup(' {}="{}"').format(key.rstrip("_").replace("_", "-"), _number(value))
        for key, value in attributes.items()
    )
    return Markup("<{}{}>{}</{}>").format(Markup(name), written, content, Markup(name))  # noqa: S704 - our own names


def joined(parts: Iterable[Markup]) -> Markup:
    """Return elements one after the other."""
    return Markup("").join(parts)


def _number(value: object) -> object:
    return f"{value:.2f}".rstrip("0").rstrip(".") if isinstance(value, float) else value


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
