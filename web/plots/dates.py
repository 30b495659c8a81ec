"""What a leaderboard is drawn with: ranks against dates, success against delays, and the shake-up of a final list."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime

from markupsafe import Markup
from vitac.envs.tasks.definition import Better
from vitac.evaluator.ranking import SUCCESS_RATE, RankingKey
from vitac.evaluator.tracks import Task, Track
from vitac.server.views.leaderboards import LeaderboardEntryView, ShakeUpView, TeamRanksView
from vitac.server.views.scores import TaskRateView

from ..rendering import percent
from .axis import Axis, Figure, Table, below, beside, element, joined

DATES_WRITTEN = 4
NAME_LENGTH = 18
"""Longest name of a team beside its line [characters]."""


@dataclass(frozen=True, kw_only=True)
class DatedValue:
    """A point of the plot.

    Attributes:
        name: what it is of.
        at: when it was submitted.
        value: of the ranking key.
        own: whether it is marked.
    """

    name: str
    at: datetime
    value: float
    own: bool = False


def values_by_date(key: str, title: str, values: Sequence[DatedValue], ranked_by: RankingKey = SUCCESS_RATE) -> Figure:
    """Return a point for each value, and a line for the best so far.

    Args:
        key: id of the plot.
        title: what is drawn.
        values: at least one.
        ranked_by: what they are values of.
    """
    points = sorted(values, key=lambda point: point.at)
    is_rate, is_high_best = ranked_by == SUCCESS_RATE, ranked_by.better is Better.HIGH
    low, high = (0.0, 1.0) if is_rate else _limits([point.value for point in points])
    x = Axis(low=points[0].at.timestamp(), high=points[-1].at.timestamp(), begin=70.0, end=556.0)
    y = Axis(low=low, high=high, begin=190.0, end=14.0)
    places = [(x.place(point.at.timestamp()), y.place(point.value)) for point in points]

    def write(value: float) -> str:
        return percent(value) if is_rate else f"{value:.3g}"

    marks = joined(
        element(
            "circle",
            element("title", f"{point.name}, {_minute(point.at)}: {write(point.value)}"),
            class_="point own" if point.own else "point",
            cx=across,
            cy=up,
            r=6 if point.own else 4,
        )
        for point, (across, up) in zip(points, places, strict=True)
    )
    best = (max if is_high_best else min)(points, key=lambda point: point.value)
    return Figure(
        key=key,
        title=title,
        summary=f"{len(points)} from {_date(points[0].at)} to {_date(points[-1].at)}; the best is {best.name} with "
        f"{write(best.value)}.",
        width=600,
        height=222,
        drawing=beside(y, 60.0, 570.0, lambda value: f"{100 * value:g} %" if is_rate else f"{value:g}")
        + element("path", class_="best", d=_steps_to_the_best(places, is_high_best=is_high_best))
        + marks
        + joined(
            element("text", text, class_="tick", x=x.place(moment.timestamp()), y=212, text_anchor="middle")
            for moment, text in _written_dates(points[0].at, points[-1].at)
        ),
        table=Table(
            columns=("Submitted (UTC)", "Of", ranked_by.title),
            rows=tuple((_minute(point.at), point.name, write(point.value)) for point in points),
        ),
    )


def _limits(values: Sequence[float]) -> tuple[float, float]:
    """Return the ends of an axis for values that are no rates: 0 is among them, and they differ."""
    low, high = min(0.0, *values), max(0.0, *values)
    return (low, high) if high > low else (low, low + 1.0)


def _steps_to_the_best(places: Sequence[tuple[float, float]], *, is_high_best: bool) -> str:
    """Return the path of the best so far; smaller y is higher."""
    path, best, sign = "", float("inf"), 1.0 if is_high_best else -1.0
    for across, up in places:
        if sign * up < best:
            path += f"H{across:.2f}V{up:.2f}" if path else f"M{across:.2f} {up:.2f}"
            best = sign * up
    return f"{path}H{places[-1][0]:.2f}"


def _written_dates(first: datetime, last: datetime) -> list[tuple[datetime, str]]:
    """Return moments and what is written below them: days, or where these would repeat, minutes, each once."""
    if _minute(first) == _minute(last):
        return [(first, _minute(first))]
    moments = [first + (last - first) * part / (DATES_WRITTEN - 1) for part in range(DATES_WRITTEN)]
    if len(set(map(_date, moments))) == DATES_WRITTEN:
        return [(moment, _date(moment)) for moment in moments]
    without_year = len("2026-")
    written = {_minute(moment)[without_year:]: moment for moment in reversed(moments)}
    return [(moment, text) for text, moment in reversed(written.items())]


def _date(moment: datetime) -> str:
    return moment.astimezone(UTC).strftime("%Y-%m-%d")


def _minute(moment: datetime) -> str:
    return moment.astimezone(UTC).strftime("%Y-%m-%d %H:%M")


def ranks_by_date(key: str, title: str, teams: Sequence[TeamRanksView], until: datetime) -> Figure:
    """Return a line of ranks for each team, with its name at the end.

    Args:
        key: id of the plot.
        title: what is drawn.
        teams: in their present order; at least one.
        until: where the lines end.
    """
    begun = min(team.ranks[0].at for team in teams)
    ranks = [one.rank for team in teams for one in team.ranks]
    x = Axis(low=begun.timestamp(), high=until.timestamp(), begin=70.0, end=440.0)
    y = Axis(low=1.0, high=float(max(2, *ranks)), begin=14.0, end=190.0, is_whole=True)
    return Figure(
        key=key,
        title=title,
        summary=f"{len(teams)} teams from {_date(begun)} to {_date(until)}; first is now {teams[0].team}.",
        width=600,
        height=222,
        drawing=beside(y, 60.0, 450.0, "{:g}".format)
        + joined(_rank_line(team, place, x, y) for place, team in enumerate(teams))
        + joined(
            element("text", text, class_="tick", x=x.place(moment.timestamp()), y=212, text_anchor="middle")
            for moment, text in _written_dates(begun, until)
        ),
        table=Table(
            columns=("Since (UTC)", "Team", "Rank"),
            rows=tuple((_minute(one.at), team.team, str(one.rank)) for team in teams for one in team.ranks),
        ),
    )


def _rank_line(team: TeamRanksView, place: int, x: Axis, y: Axis) -> Markup:
    steps = [(x.place(one.at.timestamp()), y.place(one.rank)) for one in team.ranks]
    path = f"M{steps[0][0]:.2f} {steps[0][1]:.2f}" + "".join(f"H{at:.2f}V{up:.2f}" for at, up in steps[1:])
    end = steps[-1][1]
    name = team.team if len(team.team) <= NAME_LENGTH else f"{team.team[: NAME_LENGTH - 1]}…"
    return (
        element("path", class_=f"best rank-{place}", d=f"{path}H{x.end:.2f}")
        + element(
            "circle",
            element("title", f"{team.team}: rank {team.ranks[-1].rank}"),
            class_="point",
            cx=x.end,
            cy=end,
            r=3,
        )
        + element("text", name, class_="tick", x=x.end + 12.0, y=end + 4.0)
    )


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


_ROW, _TOP = 24.0, 20.0
"""Height of a team's row, and of what is above the first one [px]."""


def draw_shake_up(teams: Sequence[ShakeUpView]) -> Figure:
    """Return a row for each team, with the difference of both rates and its 95 % interval.

    Args:
        teams: at least one, in the order of the final board.
    """
    ends = [abs(end) for team in teams for end in team.interval]
    x = Axis(low=-max(ends), high=max(ends), begin=150.0, end=570.0)
    bottom = _TOP + _ROW * len(teams)
    moved = sum(team.live_rank != team.final_rank for team in teams)
    return Figure(
        key="shake-up",
        title="Shake-up: final minus live success rate, in points",
        summary=f"{moved} of {len(teams)} teams have another place on the final list than by their live one.",
        width=600,
        height=round(bottom + 30.0),
        drawing=element("line", class_="grid", x1=x.place(0.0), x2=x.place(0.0), y1=8.0, y2=bottom)
        + joined(_draw_row(team, x, _TOP + _ROW * row) for row, team in enumerate(teams))
        + below(x, bottom, lambda value: f"{100 * value:+g}" if value else "0"),
        table=Table(
            columns=("Team", "Live", "Final", "Difference", "95 % interval", "Place by live list", "Place"),
            rows=tuple(
                (
                    team.team,
                    percent(team.live_rate),
                    percent(team.final_rate),
                    _in_points(team.final_rate - team.live_rate),
                    f"{_in_points(team.interval[0])} to {_in_points(team.interval[1])}",
                    str(team.live_rank),
                    str(team.final_rank),
                )
                for team in teams
            ),
        ),
    )


def _draw_row(team: ShakeUpView, x: Axis, y: float) -> Markup:
    difference = team.final_rate - team.live_rate
    name = team.team if len(team.team) <= NAME_LENGTH else f"{team.team[: NAME_LENGTH - 1]}…"
    low, high = map(x.place, team.interval)
    said = element("title", f"{team.team}: {_in_points(difference)}, place {team.live_rank} to {team.final_rank}")
    return (
        element("text", name, class_="tick", x=x.begin - 12.0, y=y + 4.0, text_anchor="end")
        + element("line", class_="axis", x1=low, x2=high, y1=y, y2=y)
        + element("circle", said, class_="point", cx=x.place(difference), cy=y, r=5)
    )


def _in_points(difference: float) -> str:
    return f"{100 * difference:+.1f}"
