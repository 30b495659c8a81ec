"""Success against the delay of answers, of a board's best entries. Called by the leaderboard."""

from collections.abc import Mapping, Sequence

from markupsafe import Markup
from vitac.evaluator.tracks import Task, Track
from vitac.server.views.leaderboards import LeaderboardEntryView
from vitac.server.views.scores import TaskRateView

from ..rendering import percent
from .axis import Axis, Figure, Table, below, beside, element, joined
from .dates import NAME_LENGTH

_DRAWN = 6
"""Entries that are drawn; more lines nobody tells apart."""
_APART = 14.0
"""Distance of names that would cover each other [px]."""


def success_by_delay(track: Track, entries: Sequence[LeaderboardEntryView]) -> list[Figure]:
    """Return a plot for each task that a track has under several delays, where an entry has played it under two.

    Args:
        track: whose board it is.
        entries: of the board, best first.
    """
    figures = []
    for number, tasks in enumerate(track.list_delays()):
        names = {task.name for task in tasks}
        played = [(entry, {score.task: score for score in entry.scores if score.task in names}) for entry in entries]
        drawn = [(entry, scores) for entry, scores in played if len(scores) > 1][:_DRAWN]
        if drawn:
            figures.append(_draw(f"delays-{number + 1}", tasks, drawn))
    return figures


def _draw(
    key: str, tasks: Sequence[Task], drawn: Sequence[tuple[LeaderboardEntryView, Mapping[str, TaskRateView]]]
) -> Figure:
    in_ms = all(task.delay_ms is not None for task in tasks)
    delays = {task.name: float((task.delay_ms if in_ms else task.delay_steps) or 0) for task in tasks}
    unit = "ms" if in_ms else "env steps"
    x = Axis(low=min(delays.values()), high=max(delays.values()), begin=70.0, end=440.0)
    y = Axis(low=0.0, high=1.0, begin=190.0, end=14.0)
    best, scores = drawn[0]
    ends = _spread([y.place(_points(scores, delays)[-1][1].success_rate) for _, scores in drawn])
    return Figure(
        key=key,
        title=f"{tasks[0].title}: success rate against delay [{unit}]",
        summary=f"{best.team}: "
        + ", ".join(f"{percent(score.success_rate)} at {delay:g} {unit}" for delay, score in _points(scores, delays))
        + ".",
        width=600,
        height=222,
        drawing=beside(y, 60.0, 450.0, lambda value: f"{100 * value:g} %")
        + joined(
            _line(entry.team, _points(scores, delays), at, (x, y))
            for (entry, scores), at in zip(drawn, ends, strict=True)
        )
        + below(x, 194.0, "{:g}".format),
        table=Table(
            columns=("Team", f"Delay [{unit}]", "Solved", "Success rate", "95 % interval"),
            rows=tuple(
                (
                    entry.team,
                    f"{delay:g}",
                    f"{score.successes} of {score.episodes}",
                    percent(score.success_rate),
                    f"{percent(score.success_rate_interval[0])} to {percent(score.success_rate_interval[1])}",
                )
                for entry, scores in drawn
                for delay, score in _points(scores, delays)
            ),
        ),
    )


def _points(scores: Mapping[str, TaskRateView], delays: Mapping[str, float]) -> list[tuple[float, TaskRateView]]:
    return [(delay, scores[task]) for task, delay in delays.items() if task in scores]


def _spread(places: Sequence[float]) -> list[float]:
    """Return where names stand beside the ends of their lines, none over another."""
    spread = list(places)
    above = float("-inf")
    for index in sorted(range(len(places)), key=places.__getitem__):
        above = spread[index] = max(places[index], above + _APART)
    return spread


def _line(team: str, points: Sequence[tuple[float, TaskRateView]], name_at: float, axes: tuple[Axis, Axis]) -> Markup:
    x, y = axes
    places = [(x.place(delay), y.place(score.success_rate)) for delay, score in points]
    name = team if len(team) <= NAME_LENGTH else f"{team[: NAME_LENGTH - 1]}…"
    return (
        element("path", class_="best", d="M" + "L".join(f"{across:.2f} {up:.2f}" for across, up in places))
        + joined(
            element(
                "circle",
                element("title", f"{team}, {delay:g}: {percent(score.success_rate)}"),
                class_="point",
                cx=across,
                cy=up,
                r=4,
            )
            for (delay, score), (across, up) in zip(points, places, strict=True)
        )
        + element("text", name, class_="tick", x=x.end + 12.0, y=name_at + 4.0)
    )
