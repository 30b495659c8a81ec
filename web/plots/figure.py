"""A plot as pages show it: a drawing, what it says in a sentence, and its table. Called by the modules beside it."""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

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
