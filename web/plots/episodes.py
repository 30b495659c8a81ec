"""Plots of episodes: outcome by start offset, success by shape, env steps. Called by `pages.team.figures`."""

from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from math import ceil

from markupsafe import Markup
from vitac.evaluator.episodes.records import EpisodeOutcome
from vitac.evaluator.tracks import Task, load_track
from vitac.server.views.scores import TaskScoreView
from vitac.server.views.submissions import EpisodeView

from ..rendering import percent, words
from .axis import Axis, Figure, Table, below, beside, element, joined
from .map import describe_start

CELL_PX = 20.0
MAP_PX = 300
MAX_BARS = 25


def offset_maps(track: str, task: str, ends: Mapping[int, EpisodeView]) -> list[Figure]:
    """Return a map for each shape: a square at each start offset, with a slice for each repeat, coloured by outcome.

    There are none of a task that the track has no longer.

    Args:
        track: name of the track.
        task: its task.
        ends: finished episodes by number.
    """
    definition = load_track(track).tasks.get(task)
    if definition is None:
        return []
    starts: dict[str, dict[tuple[float, ...], list[EpisodeView]]] = defaultdict(dict)
    for episode in definition.episodes:
        if episode.number in ends:
            starts[episode.shape].setdefault(episode.offset, []).append(ends[episode.number])
    return [_offset_map(definition, task, shape, of_shape) for shape, of_shape in starts.items()]


def _offset_map(
    definition: Task, task: str, shape: str, starts: Mapping[tuple[float, ...], Sequence[EpisodeView]]
) -> Figure:
    across, up = _shown_components(starts)
    columns = [f"{action.name} [{action.unit}]" for action in definition.actions]
    x = _axis([offset[across] for offset in starts], 44, MAP_PX - 16)
    height = MAP_PX if up is not None else 110
    y = _axis([0.0 if up is None else offset[up] for offset in starts], height - 52, 16)
    squares = joined(
        _square(
            x.place(offset[across]),
            y.place(0.0 if up is None else offset[up]),
            describe_start(definition, offset),
            ends,
        )
        for offset, ends in starts.items()
    )
    axes = below(x, height - 36) + element(
        "text", columns[across], class_="tick", x=MAP_PX - 16, y=height - 4, text_anchor="end"
    )
    if up is not None:
        axes += beside(y, 36.0, MAP_PX - 8.0) + element("text", columns[up], class_="tick", x=4, y=10)
    solved = sum(end.success for ends in starts.values() for end in ends)
    total = sum(map(len, starts.values()))
    name = words(shape).capitalize()
    return Figure(
        key=f"offsets-{task}-{shape}",
        title=name,
        summary=f"{name}: {solved} of {total} episodes solved, by start offset. The table has each start.",
        width=MAP_PX,
        height=height,
        drawing=axes + squares,
        table=Table(
            columns=("Start offset", "Solved", "Outcomes"),
            rows=tuple(
                (
                    describe_start(definition, offset),
                    f"{sum(end.success for end in ends)} of {len(ends)}",
                    ", ".join(words(end.outcome) for end in ends),
                )
                for offset, ends in sorted(starts.items())
            ),
        ),
    )


def _shown_components(starts: Mapping[tuple[float, ...], object]) -> tuple[int, int | None]:
    """Return the first two components of the offset that differ between starts; the second may be missing."""
    size = len(next(iter(starts)))
    varying = [index for index in range(size) if len({offset[index] for offset in starts}) > 1]
    return (varying[0] if varying else 0, varying[1] if len(varying) > 1 else None)


def _axis(values: Sequence[float], begin: float, end: float) -> Axis:
    """Return an axis on which whole squares fit at both ends."""
    inward = CELL_PX / 2 if end > begin else -CELL_PX / 2
    return Axis(low=min(values), high=max(values), begin=begin + inward, end=end - inward)


def _square(x: float, y: float, start: str, ends: Sequence[EpisodeView]) -> Markup:
    width = CELL_PX / len(ends)
    title = f"Start {start}: {', '.join(words(end.outcome) for end in ends)}"
    return element(
        "g",
        element("title", title)
        + joined(
            element(
                "rect",
                class_=f"outcome {end.outcome}",
                x=x - CELL_PX / 2 + number * width,
                y=y - CELL_PX / 2,
                width=width,
                height=CELL_PX,
            )
            for number, end in enumerate(ends)
        ),
    )


def count_outcomes(ends: Sequence[EpisodeView]) -> list[EpisodeOutcome]:
    """Return the outcomes that occur, the most frequent first: the key of the maps."""
    return [EpisodeOutcome(outcome) for outcome, _ in Counter(end.outcome for end in ends).most_common()]


def success_by_shape(score: TaskScoreView) -> Figure:
    """Return the success rate of each shape with its 95 % interval."""
    row_px, left, right = 34, 120.0, 560.0
    x = Axis(low=0.0, high=1.0, begin=left, end=right)
    height = row_px * len(score.shapes) + 40
    grid = below(x, height - 28.0, lambda value: f"{100 * value:g} %")
    rows = joined(
        element("text", words(part.shape).capitalize(), class_="label", x=0, y=row_px * number + 22.0)
        + element("line", class_="grid", x1=left, x2=right, y1=row_px * number + 18.0, y2=row_px * number + 18.0)
        + element(
            "rect",
            class_="band",
            x=x.place(part.success_rate_interval[0]),
            y=row_px * number + 13.0,
            width=x.place(part.success_rate_interval[1]) - x.place(part.success_rate_interval[0]),
            height=10,
            rx=2,
        )
        + element("circle", class_="point", cx=x.place(part.success_rate), cy=row_px * number + 18.0, r=5)
        for number, part in enumerate(score.shapes)
    )
    return Figure(
        key=f"shapes-{score.task}",
        title="Success by shape",
        summary=", ".join(f"{words(part.shape)} {percent(part.success_rate)}" for part in score.shapes),
        width=600,
        height=height,
        drawing=grid + rows,
        table=Table(
            columns=("Shape", "Solved", "Success rate", "95 % interval"),
            rows=tuple(
                (
                    words(part.shape),
                    f"{part.successes} of {part.episodes}",
                    percent(part.success_rate),
                    f"{percent(part.success_rate_interval[0])} to {percent(part.success_rate_interval[1])}",
                )
                for part in score.shapes
            ),
        ),
    )


def steps_histogram(task: str, ends: Sequence[EpisodeView]) -> Figure:
    """Return how many episodes took how many env steps, solved ones below the others."""
    most = max(end.env_steps for end in ends)
    per_bar = ceil((most + 1) / MAX_BARS)
    bars: dict[int, tuple[int, int]] = dict.fromkeys(range(most // per_bar + 1), (0, 0))
    for end in ends:
        solved, other = bars[end.env_steps // per_bar]
        bars[end.env_steps // per_bar] = (solved + end.success, other + (not end.success))
    names = {bar: _range(bar * per_bar, (bar + 1) * per_bar - 1) for bar in bars}
    x = Axis(low=0.0, high=float(len(bars)), begin=44.0, end=590.0)
    y = Axis(low=0.0, high=float(max(map(sum, bars.values()))), begin=190.0, end=34.0)
    width = (x.end - x.begin) / len(bars)
    drawn = joined(
        element(
            "g",
            element("title", f"{names[bar]} env step{'' if names[bar] == '1' else 's'}: {solved} solved, {other} not")
            + _bar("success", x.place(bar), y, width, 0, solved)
            + _bar("other", x.place(bar), y, width, solved, solved + other),
        )
        for bar, (solved, other) in bars.items()
    )
    every = ceil(len(bars) / 12)
    labels = joined(
        element("text", names[bar], class_="tick", x=x.place(bar + 0.5), y=208, text_anchor="middle")
        for bar in bars
        if bar % every == 0
    )
    return Figure(
        key=f"steps-{task}",
        title="Episodes by env steps",
        summary=f"Episodes by their number of env steps, up to {most}; the table has each number.",
        width=600,
        height=216,
        drawing=_key() + beside(y, 44.0, 590.0) + drawn + labels,
        table=Table(
            columns=("Env steps", "Solved", "Not solved"),
            rows=tuple((names[bar], str(solved), str(other)) for bar, (solved, other) in bars.items()),
        ),
    )


def _key() -> Markup:
    """Return what the histogram counts, and by which colour."""
    colours = joined(
        element("rect", class_=f"bar {outcome}", x=left, y=3, width=12, height=12)
        + element("text", name, class_="tick", x=left + 17, y=14)
        for outcome, name, left in (("success", "solved", 380), ("other", "not solved", 480))
    )
    return element("text", "episodes", class_="tick", x=4, y=14) + colours


def _bar(outcome: str, left: float, y: Axis, width: float, low: int, high: int) -> Markup:
    return element(
        "rect",
        class_=f"bar {outcome}",
        x=left + 1.0,
        y=y.place(high),
        width=max(1.0, width - 2),
        height=y.place(low) - y.place(high),
    )


def _range(low: int, high: int) -> str:
    return str(low) if low == high else f"{low} to {high}"
