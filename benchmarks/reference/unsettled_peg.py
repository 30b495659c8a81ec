"""How much of the logged peg episodes follows from IPC steps that are cut off: solved ones and cut-off ones beside it.

Usage: python benchmarks/reference/unsettled_peg.py REFERENCE_DIR [--episodes N] [--iterations N ...]
       [--oracle-episodes N] [--json FILE]

Plays the logged actions with every IPC step solved, and with every one cut off after N Newton iterations, as the 2025
simulator's after 5 (`CutOffSolverSettings`): 20 seconds of CPU for each way. Some episodes are played by the slow
oracle of the tests, too, whose Newton iterations are as rough as that simulator's: 50 iterations of conjugate gradients
each, 15 seconds for an episode. REFERENCE_DIR holds assets/track1 and logs/track1_peg_insertion.repeat0.jsonl (90
episodes). `benchmarks/physics.md` says what the figures were and mean.
"""

import argparse
import json
import sys
from collections.abc import Iterable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from vitac.envs.assets import Meshes
from vitac.envs.fem.model.settings import CutOffSolverSettings, SolverSettings
from vitac.envs.fem.scene.report import StepStatus
from vitac.envs.geometry.pegs import PegShape
from vitac.envs.scene.grasped_scene import Clocks, Stopwatch
from vitac.envs.tasks.insertion.interface import PegOffset
from vitac.envs.tasks.peg_insertion.env import PegInsertionSettings, PegScene, PegStart

sys.path.insert(0, str(Path(__file__).parents[1]))
from physics_report.figures import outcomes
from physics_report.replay import Episode, Reference, Replay, read_reference
from reference.unsettled_lock import CutOffOracle

Figures = dict[str, Any]
FloatArray = NDArray[np.float64]
ENV_STEPS = (1, 2)


def main() -> None:
    """Play, print and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("reference_dir", type=Path)
    parser.add_argument("--episodes", type=int, default=90)
    parser.add_argument("--iterations", type=int, nargs="+", default=[5])
    parser.add_argument("--oracle-episodes", type=int, default=0)
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    reference = read_reference(arguments.reference_dir)
    ways: dict[str, SolverSettings] = {"solved": SolverSettings()}
    for most in arguments.iterations:
        ways[f"cut off after {most}"] = CutOffSolverSettings(iterations_per_step=most)
    result = {"log": logged_figures(reference, arguments.episodes)}
    result |= {name: played_figures(reference, solver, arguments.episodes) for name, solver in ways.items()}
    if arguments.oracle_episodes:
        result["some episodes"] = oracle_figures(reference, arguments.oracle_episodes)
    text = json.dumps(result, indent=1)
    sys.stdout.write(text + "\n")
    if arguments.json:
        arguments.json.write_text(text + "\n")


def logged_figures(reference: Reference, episodes: int) -> Figures:
    """Return what the log says."""
    steps = [(step["n"], step) for episode in reference.log[:episodes] for step in episode["steps"]]
    return summarize_by_env_step(steps)


def played_figures(reference: Reference, solver: SolverSettings, episodes: int) -> Figures:
    """Return what the logged actions lead to here."""
    replay = Replay(reference.assets_dir, solver)
    for episode in reference.log[:episodes]:
        replay.play(episode)
    ends = outcomes(replay, reference)
    tactile = [row for row in ends if row["logged"] == "tactile"]
    statuses = [str(report.status) for report in replay.reports]
    return {
        **summarize_by_env_step((step.n, step.info) for step in replay.steps),
        "ipc_steps": {status: statuses.count(status) for status in sorted(set(statuses))},
        "net_force_left_n_median": float(np.median([report.net_force_n for report in replay.reports])),
        "logged_tactile_ends": sum(row["episodes"] for row in tactile),
        "of_them_not_ended_here": sum(row["episodes"] for row in tactile if row["ours"] == "continues"),
        "outcomes": ends,
    }


class OracleScene:
    """The oracle in place of a scene's own solver."""

    def __init__(self, oracle: CutOffOracle) -> None:
        self._oracle = oracle

    def step(self, *, driven_targets_m: list[FloatArray]) -> SimpleNamespace:
        """Advance one IPC step."""
        self._oracle.step(np.concatenate(driven_targets_m))
        return SimpleNamespace(status=StepStatus.CUT_OFF)

    def gel_positions_m(self, index: int) -> FloatArray:
        """Return the nodes of a gel [m]."""
        return self._oracle.gel_nodes_m(index)

    def body_vertices_m(self, _: int) -> FloatArray:
        """Return the vertices of the peg [m]."""
        return self._oracle.held_vertices_m()


def oracle_figures(reference: Reference, episodes: int) -> Figures:
    """Return the log, solved steps and cut-off steps of the oracle on the same episodes, spread over the list."""
    chosen = reference.log[:: max(1, len(reference.log) // episodes)][:episodes]
    meshes = Meshes(reference.assets_dir)
    found: dict[str, list[tuple[int, Figures]]] = {"log": [], "solved": [], "cut off": []}
    for episode in chosen:
        found["log"] += [(step["n"], step) for step in episode["steps"]]
        found["solved"] += played_steps(episode, meshes, cut_off=False)
        found["cut off"] += played_steps(episode, meshes, cut_off=True)
    return {"episodes": [episode["episode"] for episode in chosen]} | {
        name: summarize_by_env_step(steps) for name, steps in found.items()
    }


def played_steps(episode: Episode, meshes: Meshes, *, cut_off: bool) -> list[tuple[int, Figures]]:
    """Return what the first env steps of an episode lead to in our physics, or in the cut-off oracle."""
    x_mm, y_mm, theta_deg = episode["initial_offset"]
    scene = PegScene(
        start=PegStart(shape=PegShape(episode["shape"]), offset=PegOffset(x_mm=x_mm, y_mm=y_mm, theta_deg=theta_deg)),
        meshes=meshes,
        settings=PegInsertionSettings(),
        clocks=Clocks(physics=Stopwatch(), markers=Stopwatch()),
    )
    if cut_off:
        scene.grasped._scene = OracleScene(CutOffOracle(scene.grasped))  # type: ignore[assignment]
    scene.grasp()
    steps = []
    for step in episode["steps"][: ENV_STEPS[-1]]:
        scene.move(np.array(step["action"]))
        steps.append((step["n"], vars(scene.state())))
    return steps


def summarize_by_env_step(steps: Iterable[tuple[int, Figures]]) -> Figures:
    """Return the medians of some env steps, by their number: of the peg's corners, and of the larger surface motion."""
    found = list(steps)
    return {str(n): _medians([step for number, step in found if number == n]) for n in ENV_STEPS}


def _medians(steps: list[Figures]) -> Figures:
    corners_mm = [np.asarray(step["peg_relative_z_mm"]) for step in steps]
    return {
        "episodes": len(steps),
        "spread_of_corners_mm": round(float(np.median([np.ptp(heights) for heights in corners_mm])), 3),
        "lowest_corner_mm": round(float(np.median([heights.min() for heights in corners_mm])), 3),
        "surface_diff_mm": round(float(np.median([1e3 * np.max(step["surface_diff_m"]) for step in steps])), 3),
    }


if __name__ == "__main__":
    main()
