"""Learning curves of trainings, read from their folders, as a table; `vitac train curves` prints and stores them."""

import csv
import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import groupby
from math import floor, log10
from pathlib import Path
from typing import Any

from pydantic import NonNegativeFloat, NonNegativeInt, PositiveInt, TypeAdapter, ValidationError
from vitac.envs.fem.model.settings import ContactModel
from vitac.envs.tasks.settings import FIDELITY, Fidelity
from vitac.errors import VitacError
from vitac.evaluator.scoring.score import interval_of_seeds, rate
from vitac.evaluator.strict_model import StrictModel

LINES = 12
"""Approximate number of lines of a curve in a table."""
_MODEL = ContactModel.CHALLENGE_2025
PUBLISHED = {
    "peg-insertion": (40, 270),
    "lock-opening": (145, 160),
    "fusion-insertion": (0, 150),
    "sensor-design": (43, 270),
}
"""Successes and episodes in the logs that the challenge's organizers published, on its public lists."""


class NoCurve(VitacError):
    """A folder holds no training whose successes over env steps are known; the message says what was expected."""


class Point(StrictModel):
    """What a training solved of its held-out starts after some env steps."""

    env_steps: NonNegativeInt
    successes: NonNegativeInt
    episodes: PositiveInt


class Curve(StrictModel):
    """A training.

    `wanted` are the env steps after which it is finished, where these are known before, `cpu_s` the CPU time so far,
    where it is measured, and `options` those of the command that continues it.
    """

    task: str
    method: str
    seed: NonNegativeInt
    points: tuple[Point, ...]
    wanted: PositiveInt | None = None
    cpu_s: NonNegativeFloat | None = None
    options: str = ""

    @property
    def group(self) -> tuple[str, str]:
        """Task and method, of which several seeds are drawn together."""
        return self.task, self.method


_STORED = TypeAdapter(tuple[Curve, ...])


def read_curves(paths: Iterable[Path]) -> list[Curve]:
    """Return the curves of folders of trainings and of stored files; of the same training the last one.

    Raises:
        NoCurve: one is neither, or has no evaluation yet.
    """
    by_run = {(*curve.group, curve.seed): curve for path in paths for curve in _read(path)}
    return [by_run[key] for key in sorted(by_run)]


def write_curves(curves: Sequence[Curve]) -> str:
    """Return what is stored of curves."""
    return _STORED.dump_json(tuple(curves), indent=1, exclude_none=True).decode() + "\n"


def _read(path: Path) -> Iterator[Curve]:
    try:
        if path.is_file():
            yield from _STORED.validate_json(path.read_bytes())
            return
        recipe = json.loads((path / "run.json").read_text())["recipe"]
        is_reference = (path / "progress.csv").exists()
        curves = [_of_reference(path, recipe)] if is_reference else list(_of_rounds(path, recipe))
    except (OSError, ValueError, KeyError, ValidationError) as error:
        raise NoCurve(
            f"{path} holds no curve ({error}); expected the folder of `vitac train`, `train clone` or `train "
            "reference`, or a file that `train curves` stored."
        ) from error
    if not all(curve.points for curve in curves):
        raise NoCurve(f"{path} has no evaluation yet; expected at least one. Try again later.")
    yield from curves


def _of_reference(path: Path, recipe: Mapping[str, Any]) -> Curve:
    with (path / "progress.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    episodes = recipe["evaluation_episodes"]
    return Curve(
        task=recipe["task"],
        method=_method("train reference", recipe),
        seed=recipe["seed"],
        wanted=recipe["env_steps"],
        cpu_s=float(rows[-1]["time/cpu_s"]),
        options="".join(_options(recipe)),
        points=tuple(
            Point(
                env_steps=int(row["time/total_timesteps"]),
                successes=round(float(row["eval/success_rate"]) * episodes),
                episodes=episodes,
            )
            for row in rows
            if row["eval/success_rate"]
        ),
    )


def _of_rounds(path: Path, recipe: Mapping[str, Any]) -> Iterator[Curve]:
    for folder, ending in ((path, ""), (path / "blind", ", blind")):
        if (folder / "log.jsonl").exists():
            rows = [json.loads(line) for line in (folder / "log.jsonl").read_text().splitlines()]
            is_clone = "solved" in rows[0]
            yield Curve(
                task=recipe["task"],
                method=_method("train clone" if is_clone else "train", recipe) + ending,
                seed=recipe["seed"],
                points=tuple(_point(row["env_steps"], row["solved" if is_clone else "student"]) for row in rows),
            )


def _options(recipe: Mapping[str, Any]) -> Iterator[str]:
    if recipe["seed"]:
        yield f" --seed {recipe['seed']}"
    if recipe.get("sensor"):
        yield " --sensor FOLDER"
    for name, default in ((FIDELITY, Fidelity.FULL), ("device", "cpu")):
        if recipe.get(name, default) != default:
            yield f" --{name} {recipe[name]}"


def _method(name: str, recipe: Mapping[str, Any]) -> str:
    """Return the method with all by which what is played differs from the default, so that no two are one group."""
    model, fidelity = recipe.get("contact_model", _MODEL), recipe.get(FIDELITY, Fidelity.FULL)
    return ", ".join(
        [
            name,
            *([model] if model != _MODEL else []),
            *(["drawn"] if recipe.get("draws") else []),
            *([f"fidelity {fidelity}"] if fidelity != Fidelity.FULL else []),
        ]
    )


def _point(env_steps: int, row: Mapping[str, Any]) -> Point:
    return Point(env_steps=env_steps, successes=row["successes"], episodes=row["episodes"])


def make_page(curves: Sequence[Curve], pictures: Mapping[str, str]) -> str:
    """Return the tables of curves as Markdown, with the name of a picture for each task."""
    text = HEAD
    for task, of_task in groupby(curves, key=lambda curve: curve.task):
        text += f"\n## {task}\n![Successes over env steps]({pictures[task]})\n\n{TABLE}"
        groups = [list(seeds) for _, seeds in groupby(of_task, key=lambda curve: curve.group)]
        text += "".join(row for seeds in groups for row in _rows(seeds))
        if task in PUBLISHED:
            text += f"| the organizers' log | | | {_percent([PUBLISHED[task]])} | |\n"
        unfinished = [curve for seeds in groups for curve in seeds if (curve.wanted or 0) > curve.points[-1].env_steps]
        text += "".join(f"\n{_say_unfinished(curve)}\n" for curve in unfinished)
    return text


HEAD = """# Learning curves
Written by `vitac train curves`. Success is that of held-out random starts without noise, in % with 95 % interval: of
one training it counts starts, of several seeds the seeds (Student's, so two say little). The organizers' logs of 2025
are of the public lists, on the 2025 simulator, with intervals as if no start were repeated.
"""
TABLE = """| method | seeds | env steps | solved, % | each seed, % |
|---|---|---|---|---|
"""


def _rows(seeds: Sequence[Curve]) -> Iterator[str]:
    """Yield lines for the evaluations that all seeds have, in their order."""
    count = min(len(curve.points) for curve in seeds)
    shown = sorted({*range(0, count, -(-count // LINES)), count - 1})
    for number in shown:
        points = [curve.points[number] for curve in seeds]
        env_steps = round(sum(point.env_steps for point in points) / len(points))
        rates = [(point.successes, point.episodes) for point in points]
        each = ", ".join(f"{100 * successes / episodes:.0f}" for successes, episodes in rates)
        yield f"| `{seeds[0].method}` | {len(seeds)} | {env_steps:,} | {_percent(rates)} | {each} |\n"


def _percent(counts: Sequence[tuple[int, int]]) -> str:
    rates = [rate(*each) for each in counts]
    mean, interval = sum(each.success_rate for each in rates) / len(rates), interval_of_seeds(rates)
    return f"{100 * mean:.1f} [{100 * interval.low:.1f}, {100 * interval.high:.1f}]"


def _say_unfinished(curve: Curve) -> str:
    done, wanted = curve.points[-1].env_steps, curve.wanted or 0
    said = f"`{curve.method}`, seed {curve.seed}, was not trained to the end: {done:,} of {wanted:,} env steps"
    if curve.cpu_s is not None:
        said += f" in {curve.cpu_s / 60:.0f} minutes of CPU time, so the rest takes about "
        said += f"{curve.cpu_s / done * (wanted - done) / 3600:.1f} hours of one core"
    command = f"./vitac --torch train reference {curve.task} --out RUN{curve.options}"
    return f"{said}. `{command}` continues it from its folder RUN."


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
        interval = interval_of_seeds(rates)
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
