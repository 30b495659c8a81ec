"""Arranges the episodes of a task for its page: one map per shape, a column per start, a row per repeat.

Called by `pages.submissions`.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Literal

from markupsafe import Markup, escape
from vitac.envs.scene.perspective import signed
from vitac.evaluator.episodes.records import EpisodeOutcome
from vitac.evaluator.tracks import Task, Track, load_track
from vitac.server.views.submissions import EpisodeView

from ..rendering import words


def describe_start(task: Task, offset: Sequence[float]) -> str:
    """Return the components of a start's offset with their names and units."""
    third = "turned {}°" if any(action.name == "theta" for action in task.definition.actions) else "z {} mm"
    labels = task.definition.start_labels or ("x {} mm", "y {} mm", third, "z {} mm")
    pairs = zip(labels, offset, strict=False)  # fusion adds its hole
    return ", ".join(label.format(signed(value)) for label, value in pairs)


NOT_RUN, NOT_RUN_YET = "not run", "not run yet"
CellState = Literal["success", "other", "waiting"]


@dataclass(frozen=True, kw_only=True)
class MapCell:
    """One episode in a map; `address` is that of its page, once it is finished."""

    column: int
    row: int
    state: CellState
    label: str
    address: str | None = None

    @property
    def drawing(self) -> Markup:
        """The cell as SVG."""
        x, y, radius = 10 * self.column + 1, 10 * self.row + 1, 4 if self.state == "success" else 1
        title = f"<title>{escape(self.label)}</title>"
        rect = f'<rect class="cell {self.state}" x="{x}" y="{y}" width="8" height="8" rx="{radius}"'
        if self.address is None:
            return Markup(f"{rect}>{title}</rect>")  # noqa: S704 - numbers and a closed set; the label is escaped
        return Markup(f'<a href="{escape(self.address)}">{title}{rect}/></a>')  # noqa: S704


@dataclass(frozen=True, kw_only=True)
class ShapeMap:
    """All episodes of one shape."""

    name: str
    cells: tuple[MapCell, ...]

    @cached_property
    def columns(self) -> int:
        """Number of starts."""
        return 1 + max(cell.column for cell in self.cells)

    @cached_property
    def rows(self) -> int:
        """Number of repeats."""
        return 1 + max(cell.row for cell in self.cells)

    @cached_property
    def drawing(self) -> Markup:
        """Its cells as SVG; composed here because a template takes several times as long for this number of cells."""
        return Markup("\n".join(cell.drawing for cell in self.cells))  # noqa: S704 - each is markup

    @cached_property
    def is_linked(self) -> bool:
        """Whether a cell of it leads somewhere."""
        return any(cell.address is not None for cell in self.cells)

    @cached_property
    def total(self) -> int:
        """Number of episodes."""
        return len(self.cells)

    @cached_property
    def done(self) -> int:
        """Number of finished episodes."""
        return sum(cell.state != "waiting" for cell in self.cells)

    @cached_property
    def successes(self) -> int:
        """Number of successful episodes."""
        return sum(cell.state == "success" for cell in self.cells)


@dataclass(frozen=True, kw_only=True)
class CountedOutcome:
    """How many episodes ended in one way; `episode` is the first of them, `address` that of its page."""

    outcome: EpisodeOutcome
    count: int
    episode: int
    address: str | None


@dataclass(frozen=True, kw_only=True)
class EpisodeMap:
    """The episodes of one task, and how they ended, the most frequent end first (empty before the first)."""

    task: str
    title: str
    shapes: tuple[ShapeMap, ...]
    outcomes: tuple[CountedOutcome, ...]


@dataclass(frozen=True, kw_only=True)
class PlotPlace:
    """Where the cell of an episode is, and how its label begins."""

    number: int
    column: int
    row: int
    label: str


def episode_map(
    track: str,
    task: str,
    ends: Mapping[int, EpisodeView],
    *,
    folder: str,
    known: bool = True,
    has_ended: bool = False,
) -> EpisodeMap:
    """Arrange the episodes of a task; there are no maps of one that the track has no longer.

    Args:
        track: name of its track.
        task: its name.
        ends: finished episodes by number.
        folder: address below which each finished episode has a page.
        known: the starts are those of the track's file.
        has_ended: the evaluation has, so that no other episode will be run.
    """
    definition, otherwise = load_track(track), NOT_RUN if has_ended else NOT_RUN_YET
    layout = _layout(track, task, known=known) if task in definition.tasks else {}
    return EpisodeMap(
        task=task,
        title=title_of_task(definition, task),
        shapes=tuple(
            ShapeMap(
                name=shape, cells=tuple(_cell(place, ends.get(place.number), folder, otherwise) for place in places)
            )
            for shape, places in layout.items()
        ),
        outcomes=_count_outcomes(ends, folder if layout else None),
    )


def _count_outcomes(ends: Mapping[int, EpisodeView], folder: str | None) -> tuple[CountedOutcome, ...]:
    first = {ends[number].outcome: number for number in sorted(ends, reverse=True)}
    return tuple(
        CountedOutcome(
            outcome=EpisodeOutcome(outcome),
            count=count,
            episode=first[outcome],
            address=f"{folder}/{first[outcome]}" if folder else None,
        )
        for outcome, count in Counter(end.outcome for end in ends.values()).most_common()
    )


def title_of_task(track: Track, task: str) -> str:
    """Return how a task is called on pages; one that the track has no longer by its name."""
    definition = track.tasks.get(task)
    return words(task) if definition is None else definition.title


@cache
def _layout(track: str, task: str, *, known: bool) -> Mapping[str, tuple[PlotPlace, ...]]:
    """Return the places of all episodes, by shape."""
    definition = load_track(track).task(task)
    return {shape: _places(shape, definition, known=known) for shape in definition.episode_list.shapes}


def _places(shape: str, task: Task, *, known: bool) -> tuple[PlotPlace, ...]:
    columns: dict[tuple[float, ...], int] = {}
    repeats: Counter[tuple[float, ...]] = Counter()
    places = []
    for episode in task.episodes:
        if episode.shape == shape:
            column = columns.setdefault(episode.offset, len(columns))
            start = f", start {describe_start(task, episode.offset)}" if known else ""
            label = f"Episode {episode.number}{start}: "
            places.append(PlotPlace(number=episode.number, column=column, row=repeats[episode.offset], label=label))
            repeats[episode.offset] += 1
    return tuple(places)


def _cell(place: PlotPlace, end: EpisodeView | None, folder: str, otherwise: str) -> MapCell:
    if end is None:
        return MapCell(column=place.column, row=place.row, state="waiting", label=place.label + otherwise)
    state: CellState = "success" if end.success else "other"
    how = f"{words(end.outcome)} at env step {end.env_steps}. {EpisodeOutcome(end.outcome).sentence}"
    address = f"{folder}/{place.number}"
    return MapCell(column=place.column, row=place.row, state=state, label=place.label + how, address=address)
