"""Measures what it costs to refuse a bad STL, by kind: rule, CPU time and memory of `vitac sensor check`, as a table.

Usage: python benchmarks/sensors/refusals.py. Each kind is a gel of almost as many triangles as are allowed, because
the time grows with them; the last one is sound. Run it twice, for the first run also compiles.
"""

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
from vitac.envs.sensor_design.surface import DrawnSurface

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tests" / "support" / "envs"))

import drawn_gels

CHECK = (sys.executable, "-c", "from vitac.cli.main import main; main()", "sensor", "check", "--json")
CELLS = 69
"""Of the finest top with a base alike that keeps to 20,000 triangles."""


class Cost(NamedTuple):
    """What one `vitac sensor check` took.

    Attributes:
        rule: the first broken one; None where all are kept.
        triangles: of the STL.
        cpu_s: CPU time, that of starting Python included.
        memory_mib: largest resident memory.
    """

    rule: str | None
    triangles: int
    cpu_s: float
    memory_mib: float


def dome() -> DrawnSurface:
    """Return a sound gel."""
    return drawn_gels.dome(cells=CELLS)


def remove_triangle() -> DrawnSurface:
    """Return one that is open where a triangle was."""
    gel = dome()
    return DrawnSurface(vertices_mm=gel.vertices_mm, triangles=gel.triangles[1:])


def half_turned() -> DrawnSurface:
    """Return one of which every second triangle looks inwards."""
    gel = dome()
    gel.triangles[::2] = gel.triangles[::2, ::-1]
    return gel


def through_its_base() -> DrawnSurface:
    """Return one whose highest vertex is pulled through the base."""
    gel = dome()
    gel.vertices_mm[gel.vertices_mm[:, 2].argmax(), 2] = -1.0
    return gel


def two_bodies() -> DrawnSurface:
    """Return one dome above another."""
    half = drawn_gels.dome(cells=CELLS * 7 // 10)
    return drawn_gels.together(half, drawn_gels.moved(half, by=(0.0, 0.0, 6.0)))


def set_infinity() -> DrawnSurface:
    """Return one with an infinite coordinate."""
    gel = dome()
    gel.vertices_mm[-1, 2] = np.inf
    return gel


def rough() -> DrawnSurface:
    """Return a top of random heights."""
    random = np.random.default_rng(0)
    return drawn_gels.smooth(lambda _x, _y: float(random.uniform(3.0, 4.0)), CELLS)


def comb() -> DrawnSurface:
    """Return forty walls, 0.15 mm thick."""
    bars = [[(x, -9.0), (x + 0.15, -9.0), (x + 0.15, 9.0), (x, 9.0)] for x in np.arange(-10.0, 10.0, 0.5).tolist()]
    return drawn_gels.pillars(bars)


def sponge() -> DrawnSurface:
    """Return a box with as many closed cavities as it may have triangles for."""
    box = drawn_gels.flat(4.0)
    places = np.stack(np.meshgrid(np.arange(-12, 12, 0.8), np.arange(-10, 10, 0.8), [0.5, 1.7]), axis=-1).reshape(-1, 3)
    small = drawn_gels.turned_inside_out(drawn_gels.moved(drawn_gels.stretched(box, (0.02, 0.02, 0.2))))
    return drawn_gels.together(box, *(drawn_gels.moved(small, by=tuple(place)) for place in places.tolist()))


def fan(rim: int = 4990) -> DrawnSurface:
    """Return a roof and a base of slivers that meet in a point each: all of them are near each other."""
    along = np.linspace(0.0, 4.0, rim, endpoint=False)
    corners = np.array([(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5), (-0.5, -0.5)])
    side, part = along.astype(int), (along % 1.0)[:, None]
    outline = (corners[side] * (1.0 - part) + corners[side + 1] * part) * [drawn_gels.LENGTH_MM, drawn_gels.WIDTH_MM]
    low, high = np.insert(outline, 2, 0.0, axis=1), np.insert(outline, 2, 3.0, axis=1)
    next_low, next_high = np.roll(low, -1, axis=0), np.roll(high, -1, axis=0)
    tip, middle = np.broadcast_to([0.0, 0.0, 4.0], low.shape), np.zeros(low.shape)
    rows = [(tip, high, next_high), (middle, next_low, low), (low, next_low, next_high), (low, next_high, high)]
    return DrawnSurface.from_corners(np.concatenate([np.stack(row, axis=1) for row in rows]))


KINDS: dict[str, Callable[[], DrawnSurface]] = {
    "open": remove_triangle,
    "inverted": lambda: drawn_gels.turned_inside_out(dome()),
    "mixed orientation": half_turned,
    "self-intersecting": through_its_base,
    "several bodies": two_bodies,
    "flat": lambda: drawn_gels.smooth(lambda _x, _y: 1e-4, CELLS),
    "not finite": set_infinity,
    "in metres": lambda: drawn_gels.moved(dome(), scale=1e-3),
    "too many triangles": lambda: drawn_gels.dome(cells=110),
    "features too small: random heights": rough,
    "features too small: 40 walls of 0.15 mm": comb,
    "too many near triangles": fan,
    "overhangs: 1,500 cavities": sponge,
    "none: a dome": dome,
}


def measure_cost(gel: DrawnSurface, folder: Path) -> Cost:
    """Check a gel in a process of its own."""
    path = folder / "gel.stl"
    path.write_bytes(drawn_gels.stl_bytes(gel))
    process = subprocess.Popen([*CHECK, str(path)], stdout=subprocess.PIPE)  # noqa: S603 - our own command
    assert process.stdout is not None  # noqa: S101 - asked for above
    answer = process.stdout.read()
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    broken = [finding["rule"] for finding in json.loads(answer)["findings"] if not finding["ok"]]
    return Cost(
        rule=next(iter(broken), None),
        triangles=len(gel.triangles),
        cpu_s=usage.ru_utime + usage.ru_stime,
        memory_mib=usage.ru_maxrss / 1024,
    )


def main() -> None:
    """Measure all kinds, and print them as a table."""
    print("| fault | refused as | triangles | CPU time [s] | memory [MiB] |\n|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as name:
        for kind, drawn in KINDS.items():
            cost = measure_cost(drawn(), Path(name))
            rule = f"`{cost.rule}`" if cost.rule else "not at all"
            print(f"| {kind} | {rule} | {cost.triangles} | {cost.cpu_s:.1f} | {cost.memory_mib:.0f} |", flush=True)


if __name__ == "__main__":
    main()
