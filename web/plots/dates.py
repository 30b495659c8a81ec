"""What ranks against dates: of a team's submissions, and of a board's entries. Called by the pages."""

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime

from markupsafe import Markup
from vitac.envs.tasks.definition import Better
from vitac.evaluator.ranking import SUCCESS_RATE, RankingKey
from vitac.server.views.leaderboards import TeamRanksView

from ..rendering import percent
from .axis import Axis, Figure, Table, beside, element, joined

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
