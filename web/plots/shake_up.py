"""The shake-up: how success rates on the final list differ from those on the live one. Called by the leaderboard."""

from collections.abc import Sequence

from markupsafe import Markup
from vitac.server.views.leaderboards import ShakeUpView

from ..rendering import percent
from .axis import Axis, Figure, Table, below, element, joined
from .dates import NAME_LENGTH

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
                    _points(team.final_rate - team.live_rate),
                    f"{_points(team.interval[0])} to {_points(team.interval[1])}",
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
    said = element("title", f"{team.team}: {_points(difference)}, place {team.live_rank} to {team.final_rank}")
    return (
        element("text", name, class_="tick", x=x.begin - 12.0, y=y + 4.0, text_anchor="end")
        + element("line", class_="axis", x1=low, x2=high, y1=y, y2=y)
        + element("circle", said, class_="point", cx=x.place(difference), cy=y, r=5)
    )


def _points(difference: float) -> str:
    return f"{100 * difference:+.1f}"
