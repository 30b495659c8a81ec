"""Largest force on the held part of every episode, by whether it was solved. Called by `pages.submissions.figures`."""

from collections.abc import Sequence
from statistics import median

from markupsafe import Markup
from vitac.evaluator.episodes.records import ContactForces, ForceFigures
from vitac.evaluator.scoring.score import summarize_forces
from vitac.server.views.submissions import EpisodeView

from .axis import Axis, below
from .figure import Figure, Table, element, joined

_WIDTH, _ROW, _LEFT = 600, 46, 96.0


def peak_forces(task: str, ends: Sequence[EpisodeView]) -> Figure | None:
    """Return a plot with a dot for each episode, and a table of the medians; None where no forces are recorded.

    Args:
        task: what was played.
        ends: its finished episodes.
    """
    groups = {"Solved": _forces(ends, success=True), "Not solved": _forces(ends, success=False)}
    shown = {name: forces for name, forces in groups.items() if forces}
    if not shown:
        return None
    everything = [each for forces in shown.values() for each in forces]
    threshold_n = everything[0].over_force_n
    x = Axis(low=0.0, high=max(threshold_n, *(each.part.peak_n for each in everything)), begin=_LEFT, end=_WIDTH - 16.0)
    bottom = _ROW * len(shown) + 8.0
    limit = element("line", class_="threshold", x1=x.place(threshold_n), x2=x.place(threshold_n), y1=4.0, y2=bottom)
    rows = joined(_row(name, forces, number, x) for number, (name, forces) in enumerate(shown.items()))
    medians = ", ".join(f"{name.lower()} {_peak_n(forces):.1f} N" for name, forces in shown.items())
    return Figure(
        key=f"forces-{task}",
        title="Largest force on the held part",
        summary=f"Largest force on the held part, medians of episodes: {medians}. Dashed: {threshold_n:g} N.",
        width=_WIDTH,
        height=round(bottom) + 24,
        drawing=limit + rows + below(x, bottom, "{:g} N".format),
        table=_table(shown, everything),
    )


def _forces(ends: Sequence[EpisodeView], *, success: bool) -> list[ContactForces]:
    return [end.forces for end in ends if end.forces is not None and end.success is success]


def _peak_n(forces: Sequence[ContactForces]) -> float:
    return median(each.part.peak_n for each in forces)


def _row(name: str, forces: Sequence[ContactForces], number: int, x: Axis) -> Markup:
    """Return the dots of a group, one below the other where they would cover each other, and its median as a bar."""
    middle = _ROW * number + _ROW / 2
    at = x.place(_peak_n(forces))
    dots = joined(
        element(
            "circle", class_="point faint", cx=x.place(each.part.peak_n), cy=middle - 12.0 + 6.0 * (place % 5), r=2.5
        )
        for place, each in enumerate(sorted(forces, key=lambda each: each.part.peak_n))
    )
    bar = element("line", class_="median", x1=at, x2=at, y1=middle - 18.0, y2=middle + 18.0)
    return element("text", name, class_="label", x=0, y=middle + 4.0) + dots + bar


def _table(shown: dict[str, list[ContactForces]], everything: Sequence[ContactForces]) -> Table:
    groups = {f"On the held part, {name.lower()}": summarize_forces(forces) for name, forces in shown.items()}
    whole = summarize_forces(everything)
    assert whole is not None  # noqa: S101 - there is an episode
    above = f"{whole.over_force_events} times above {whole.over_force_n:g} N on the held part"
    rows = [
        *((name, *_figures(found.episodes, found.part)) for name, found in groups.items() if found is not None),
        ("On the more loaded gel", *_figures(whole.episodes, whole.gel)),
        (above, f"{whole.over_force_episodes}", "", "", ""),
        (f"Largest stretch of a gel: {whole.largest_stretch:.2f}", f"{whole.episodes}", "", "", ""),
    ]
    columns = ("Medians of the episodes", "Episodes", "Peak [N]", "95th percentile [N]", "Impulse [N s]")
    return Table(columns=columns, rows=tuple(rows))


def _figures(episodes: int, found: ForceFigures) -> tuple[str, ...]:
    return f"{episodes}", f"{found.peak_n:.1f}", f"{found.p95_n:.1f}", f"{found.impulse_n_s:.1f}"
