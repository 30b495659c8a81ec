"""Draws the learning curves of a task as SVG: for each method the mean of its seeds, and a band for the interval."""

from collections.abc import Iterator, Sequence
from itertools import groupby
from math import floor, log10

from vitac.evaluator.scoring.score import interval_of_mean, rate

from .curves import PUBLISHED, Curve

WIDTH, HEIGHT = 640, 300
LEFT, RIGHT, TOP, BOTTOM = 56.0, 440.0, 16.0, 260.0
COLOURS = ("#2563eb", "#d97706", "#059669", "#9333ea", "#dc2626", "#475569")
"""One for each method, in the order of their names."""


def draw_curves(curves: Sequence[Curve]) -> str:
    """Return the picture of the curves of one task, env steps on a logarithmic axis."""
    steps = [point.env_steps for curve in curves for point in curve.points]
    low, high = log10(max(1, min(steps))) - 0.05, log10(max(steps)) + 0.05

    def across(env_steps: float) -> float:
        return LEFT + (log10(max(1.0, env_steps)) - low) / (high - low) * (RIGHT - LEFT)

    parts = [_axes(), *(_tick(across(value), value) for value in _round_values(low, high))]
    groups = [list(seeds) for _, seeds in groupby(curves, key=lambda curve: curve.group)]
    names = []
    for colour, seeds in zip(COLOURS, groups, strict=False):
        places = [
            (across(env_steps), _up(mean), _up(least), _up(most)) for env_steps, mean, least, most in _means(seeds)
        ]
        parts.append(_band(places, colour))
        names.append((f"{seeds[0].method} ({len(seeds)})", colour, places[-1][1]))
    successes, episodes = PUBLISHED.get(curves[0].task, (0, 0))
    if episodes:
        up = _up(successes / episodes)
        parts.append(f'<path d="M{LEFT} {up:.1f}H{RIGHT}" stroke="#111" stroke-dasharray="5 4" fill="none"/>')
        names.append(("organizers' log", "#111", up))
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" font-family="sans-serif" '
        f'font-size="12"><title>{curves[0].task}</title><rect width="{WIDTH}" height="{HEIGHT}" fill="#fff"/>'
        + "\n".join([*parts, *_labels(names)])
        + "</svg>\n"
    )


def _means(seeds: Sequence[Curve]) -> Iterator[tuple[float, float, float, float]]:
    """Yield env steps, mean success rate and its interval of each evaluation that all seeds have."""
    for points in zip(*(curve.points for curve in seeds), strict=False):
        rates = [rate(point.successes, point.episodes) for point in points]
        interval = interval_of_mean(rates, of=len(rates))
        mean = sum(each.success_rate for each in rates) / len(rates)
        yield sum(point.env_steps for point in points) / len(points), mean, interval.low, interval.high


def _up(success_rate: float) -> float:
    return BOTTOM - success_rate * (BOTTOM - TOP)


def _axes() -> str:
    lines = "".join(
        f'<path d="M{LEFT} {_up(value):.1f}H{RIGHT}" stroke="#ddd"/>'
        f'<text x="{LEFT - 8}" y="{_up(value) + 4:.1f}" text-anchor="end">{value:.0%}</text>'
        for value in (0.0, 0.25, 0.5, 0.75, 1.0)
    )
    return f'{lines}<text x="{(LEFT + RIGHT) / 2}" y="{HEIGHT - 6}" text-anchor="middle">env steps</text>'


def _round_values(low: float, high: float) -> list[int]:
    """Return 1, 2 and 5 times powers of ten within an axis, at most every second one where there are many."""
    powers = range(floor(low), floor(high) + 1)
    values = [digit * 10**power for power in powers for digit in (1, 2, 5) if low <= log10(digit * 10**power) <= high]
    return values if len(values) < 7 else values[::2]


def _tick(x: float, value: int) -> str:
    return f'<text x="{x:.1f}" y="{BOTTOM + 16}" text-anchor="middle">{value:,}</text>'


def _band(places: Sequence[tuple[float, float, float, float]], colour: str) -> str:
    """Return a line of means and the area of the intervals; one place alone is a bar."""
    line = " ".join(f"{x:.1f},{mean:.1f}" for x, mean, _, _ in places)
    edge = [*((x, low) for x, _, low, _ in places), *((x, high) for x, _, _, high in reversed(places))]
    area = " ".join(f"{x:.1f},{y:.1f}" for x, y in edge)
    dots = "".join(f'<circle cx="{x:.1f}" cy="{mean:.1f}" r="2.5" fill="{colour}"/>' for x, mean, _, _ in places)
    return (
        f'<polygon points="{area}" fill="{colour}" fill-opacity="0.15" stroke="{colour}" stroke-opacity="0.15"/>'
        f'<polyline points="{line}" fill="none" stroke="{colour}" stroke-width="1.5"/>{dots}'
    )


def _labels(names: Sequence[tuple[str, str, float]]) -> Iterator[str]:
    """Yield names at the ends of their lines, moved apart where they would overlap."""
    last = TOP - 16.0
    for name, colour, up in sorted(names, key=lambda each: each[2]):
        last = max(up + 4.0, last + 14.0)
        yield f'<text x="{RIGHT + 10}" y="{last:.1f}" fill="{colour}">{name}</text>'
