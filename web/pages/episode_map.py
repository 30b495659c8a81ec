"""Arranges the episodes of a task for its page: one map per shape, a column per start, a row per repeat.

Called by `submissions`.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from vitac.evaluator.tracks import Episode, Task
    from vitac.server.views.submissions import EpisodeView

CellState = Literal["success", "other", "waiting"]


@dataclass(frozen=True, kw_only=True)
class Cell:
    """One episode in a map."""

    column: int
    row: int
    state: CellState
    label: str


@dataclass(frozen=True, kw_only=True)
class ShapeMap:
    """All episodes of one shape."""

    name: str
    cells: tuple[Cell, ...]

    @property
    def columns(self) -> int:
        """Number of starts."""
        return 1 + max(cell.column for cell in self.cells)

    @property
    def rows(self) -> int:
        """Number of repeats."""
        return 1 + max(cell.row for cell in self.cells)

    @property
    def total(self) -> int:
        """Number of episodes."""
        return len(self.cells)

    @property
    def done(self) -> int:
        """Number of finished episodes."""
        return sum(cell.state != "waiting" for cell in self.cells)

    @property
    def successes(self) -> int:
        """Number of successful episodes."""
        return sum(cell.state == "success" for cell in self.cells)


@dataclass(frozen=True, kw_only=True)
class EpisodeMap:
    """The episodes of one task, and the number of each outcome (empty before the first)."""

    task: str
    title: str
    shapes: tuple[ShapeMap, ...]
    outcomes: Mapping[str, int]


def episode_map(name: str, task: Task, ends: Mapping[int, EpisodeView]) -> EpisodeMap:
    """Arrange the episodes of a task.

    Args:
        name: the task's name.
        task: its definition with the fixed list of starts.
        ends: finished episodes by number; the others are waiting.
    """
    return EpisodeMap(
        task=name,
        title=task.title,
        shapes=tuple(_shape_map(shape, task.episodes, ends) for shape in task.episode_list.shapes),
        outcomes=dict(Counter(end.outcome for end in ends.values()).most_common()),
    )


def _shape_map(shape: str, episodes: Sequence[Episode], ends: Mapping[int, EpisodeView]) -> ShapeMap:
    columns: dict[tuple[float, ...], int] = {}
    repeats: Counter[tuple[float, ...]] = Counter()
    cells = []
    for episode in episodes:
        if episode.shape == shape:
            column = columns.setdefault(episode.offset, len(columns))
            cells.append(_cell(episode, column, repeats[episode.offset], ends.get(episode.number)))
            repeats[episode.offset] += 1
    return ShapeMap(name=shape, cells=tuple(cells))


def _cell(episode: Episode, column: int, row: int, end: EpisodeView | None) -> Cell:
    start = ", ".join(f"{value:g}" for value in episode.offset)
    label = f"Episode {episode.number}, start ({start}): "
    if end is None:
        return Cell(column=column, row=row, state="waiting", label=f"{label}not run yet")
    state: CellState = "success" if end.success else "other"
    how = end.outcome.replace("_", " ")
    return Cell(column=column, row=row, state=state, label=f"{label}{how} at env step {end.env_steps}")
