"""What the number of gel nodes costs: the peg task's grasp and two env steps on structured gels of many sizes, as JSON.

Usage: python benchmarks/gel_size.py [--max-nodes N | --write-docs]

Three families: refined in all directions, one layer thick, and two; and odd ones (thick, domed). Exponents are slopes
of log(value) by log(nodes) within a family. One thread, no GPU; run it twice, for the first run also compiles.
`--write-docs` keeps the figures in benchmarks/physics.json and writes tables and picture of
benchmarks/physics.md.
"""

import argparse
import json
import sys
from pathlib import Path
from time import process_time

import numpy as np
from physics_report.document import REPOSITORY, keep
from physics_report.tables import GEL_QUANTITIES, Figures
from vitac.envs.assets import Meshes
from vitac.envs.fem.linear.elimination import factorise
from vitac.envs.fem.scene.report import StepReport
from vitac.envs.geometry.pegs import PegShape
from vitac.envs.scene.grasped_scene import Clocks, Stopwatch
from vitac.envs.tactile.gel import GelCells, GelDimensions, structured_gel
from vitac.envs.tasks.insertion.interface import PegOffset
from vitac.envs.tasks.peg_insertion.env import PegInsertionSettings, PegScene, PegStart

PLAIN, THICK, DOMED = GelDimensions(), GelDimensions(thickness_mm=8.0), GelDimensions(dome_mm=0.5)
GELS: dict[str, tuple[GelCells, GelDimensions]] = {
    "162": (GelCells(x=6, y=6, bevel=1, layers=1), PLAIN),
    "330": (GelCells(x=8, y=7, bevel=1, layers=2), PLAIN),
    "720": (GelCells(x=13, y=12, bevel=1, layers=2), PLAIN),
    "1216": (GelCells(x=14, y=11, bevel=2, layers=3), PLAIN),
    "2016": (GelCells(x=19, y=16, bevel=2, layers=3), PLAIN),
    "5022": (GelCells(x=24, y=20, bevel=3, layers=5), PLAIN),
    "338": (GelCells(x=10, y=10, bevel=1, layers=1), PLAIN),
    "722": (GelCells(x=16, y=16, bevel=1, layers=1), PLAIN),
    "1250": (GelCells(x=20, y=20, bevel=2, layers=1), PLAIN),
    "2048": (GelCells(x=27, y=27, bevel=2, layers=1), PLAIN),
    "5000": (GelCells(x=43, y=43, bevel=3, layers=1), PLAIN),
    "1260": (GelCells(x=18, y=17, bevel=1, layers=2), PLAIN),
    "2184": (GelCells(x=25, y=23, bevel=1, layers=2), PLAIN),
    "4797": (GelCells(x=38, y=36, bevel=1, layers=2), PLAIN),
    "thick": (GelCells(x=8, y=7, bevel=1, layers=4), THICK),
    "domed": (GelCells(x=8, y=7, bevel=1, layers=2), DOMED),
}
FAMILIES = {
    "refined in all directions": ("162", "330", "720", "1216", "2016", "5022"),
    "one layer thick": ("162", "338", "722", "1250", "2048", "5000"),
    "two layers thick": ("330", "720", "1260", "2184", "4797"),
}
ODD = {"8 mm thick": ("thick",), "domed by 0.5 mm": ("domed",)}
PICTURE = REPOSITORY / "docs" / "pictures" / "gel-size.png"
OFFSETS = (
    PegOffset(x_mm=-4.0, y_mm=1.0, theta_deg=-6.0),
    PegOffset(x_mm=-3.0, y_mm=0.5, theta_deg=-4.0),
    PegOffset(x_mm=-2.0, y_mm=0.0, theta_deg=-2.0),
)


def measure(name: str, cells: GelCells, size: GelDimensions) -> Figures:
    """Play the scene on one gel."""
    begun_s = process_time()
    gel = structured_gel(name=name, size=size, cells=cells)
    plan = gel.elimination
    clocks = Clocks(physics=Stopwatch(), markers=Stopwatch())
    scene = PegScene(
        start=PegStart(shape=PegShape.CUBOID, offset=OFFSETS[0]),
        meshes=Meshes(gel=gel),
        settings=PegInsertionSettings(),
        clocks=clocks,
    )
    set_up_s = process_time() - begun_s
    before_s = clocks.physics.elapsed_s
    scene.grasp()
    for offset in OFFSETS[1:]:
        scene.travel(offset)
    physics_s = clocks.physics.elapsed_s - before_s
    reports: tuple[StepReport, ...] = scene.grasped.take_reports()
    iterations = sum(report.newton_iterations for report in reports)
    fronts = np.diff(plan.first) + np.array([len(rows) for rows in plan.rows])
    return {
        "nodes": len(gel.driven),
        "free_nodes": len(plan.nodes),
        "tetrahedra": len(gel.tetrahedra),
        "set_up_ms": set_up_s * 1e3,
        "ms_per_ipc_step": physics_s / len(reports) * 1e3,
        "ms_per_newton_iteration": physics_s / iterations * 1e3,
        "ms_per_factorisation": factorisation_s(scene) * 1e3,
        "newton_iterations_per_ipc_step": iterations / len(reports),
        "ipc_steps": len(reports),
        "status": sorted({str(report.status) for report in reports}),
        "active_contacts": reports[-1].active_contacts,
        "largest_front_nodes": int(fronts.max()),
        "solver_mb": solver_bytes(scene) * 1e-6,
        "surface_diff_mm": (scene.grasped.surface_diff_m() * 1e3).tolist(),
    }


def factorisation_s(scene: PegScene) -> float:
    """Return the CPU time of one factorisation of the last matrix, the shortest of five."""
    engine = scene.grasped._scene
    system, workspace = engine._model.system, engine._workspace
    times_s = []
    for _ in range(5):
        begun_s = process_time()
        factorise(system, workspace.system.entries, workspace.factor, False)
        times_s.append(process_time() - begun_s)
    return min(times_s)


def solver_bytes(scene: PegScene) -> int:
    """Return the size of the matrix, its factors and what makes them."""
    workspace = scene.grasped._scene._workspace
    factor = workspace.factor
    return sum(part.nbytes for part in (workspace.system.entries, factor.entries, factor.front, factor.stack))


def exponent(rows: list[Figures], key: str) -> float:
    """Return the slope of log(value) by log(nodes), least squares."""
    nodes, values = np.log([row["nodes"] for row in rows]), np.log([row[key] for row in rows])
    nodes = nodes - nodes.mean()
    return float((nodes * values).sum() / (nodes * nodes).sum())


def node_count(cells: GelCells) -> int:
    """Return the nodes of a gel of these cells."""
    return (cells.x + 2 * cells.bevel + 1) * (cells.y + 2 * cells.bevel + 1) * (cells.layers + 1)


def draw(families: dict[str, list[Figures]], path: Path) -> None:
    """Draw the curves of the families, on logarithmic axes."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(5.0, 3.2), layout="constrained")
    axes = figure.subplots()
    for (family, rows), marker in zip(families.items(), "os^", strict=True):
        times_ms = [row["ms_per_ipc_step"] for row in rows]
        axes.loglog([row["nodes"] for row in rows], times_ms, marker=marker, label=family)
    smallest = families["one layer thick"][0]
    ends = np.array([smallest["nodes"], 5000.0])
    axes.loglog(ends, smallest["ms_per_ipc_step"] * ends / ends[0], "k:", linewidth=1.0, label="linear")
    axes.set(xlabel="nodes per gel", ylabel="CPU time per IPC step [ms]")
    axes.set_xticks([200, 500, 1000, 2000, 5000], ["200", "500", "1000", "2000", "5000"])
    axes.tick_params(which="minor", bottom=False, labelbottom=False)
    axes.grid(alpha=0.3)
    axes.legend()
    figure.savefig(path, dpi=110)


def main() -> None:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    which = parser.add_mutually_exclusive_group()
    which.add_argument("--max-nodes", type=int, default=10**6)
    which.add_argument("--write-docs", action="store_true")
    arguments = parser.parse_args()
    measure("warm-up", *GELS["162"])
    gels: Figures = {}
    for name, (cells, size) in GELS.items():
        if node_count(cells) <= arguments.max_nodes:
            gels[name] = measure(name, cells, size)
            sys.stderr.write(f"{name}: {gels[name]['ms_per_ipc_step']:.1f} ms per IPC step\n")
    families = {family: [gels[name] for name in names if name in gels] for family, names in FAMILIES.items()}
    exponents = {
        family: {key: exponent(rows, key) for key in GEL_QUANTITIES}
        for family, rows in families.items()
        if len(rows) > 1
    }
    figures = {"gels": gels, "gel_families": FAMILIES | ODD, "gel_exponents": exponents}
    if arguments.write_docs:
        keep(figures)
        draw(families, PICTURE)
    sys.stdout.write(json.dumps(figures, indent=1) + "\n")


if __name__ == "__main__":
    main()
