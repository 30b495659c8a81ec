"""Speed of the physics on the organizers' logged peg episodes, and its agreement with settled states, as JSON.

Usage: python benchmarks/physics.py REFERENCE_DIR [--episodes N] [--json FILE]

REFERENCE_DIR holds assets/track1, logs/track1_peg_insertion.repeat0.jsonl and physics_truth.json. One thread, no GPU;
run it twice, for the first run also compiles the kernels. `docs/physics.md` says what the figures were.
"""

import argparse
import json
import sys
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
from vitac.envs.fem.scene import StepReport
from vitac.envs.peg_insertion.env import PegInsertionEnv

Episode = dict[str, Any]
AGREEMENT_MM = 0.03


class Replay:
    """Plays logged episodes and keeps what every IPC step took."""

    def __init__(self, assets_dir: Path) -> None:
        self.env = PegInsertionEnv(assets_dir=assets_dir)
        self.reports: list[StepReport] = []
        self.step_ms: list[float] = []
        self.reset_ms: list[float] = []
        self._clock_s = 0.0

    def play(self, episode: Episode) -> list[np.ndarray[Any, np.dtype[np.float64]]]:
        """Surface motion of both sensors after each env step [mm]."""
        before_s = self.env.physics_cpu_s
        _, info = self.env.reset(options={"shape": episode["shape"], "offset_mm_deg": episode["initial_offset"]})
        self.reset_ms.append((self.env.physics_cpu_s - before_s) * 1e3)
        self.reports.extend(info["step_reports"])
        self.env.scene.after_ipc_step = self._lap
        motions = []
        for step in episode["steps"]:
            self._clock_s = self.env.physics_cpu_s
            *_, info = self.env.step(np.array(step["action"], dtype=np.float32))
            self.reports.extend(info["step_reports"])
            motions.append(info["surface_diff_m"] * 1e3)
        return motions

    def _lap(self) -> None:
        now_s = self.env.physics_cpu_s
        self.step_ms.append((now_s - self._clock_s) * 1e3)
        self._clock_s = now_s


def speed(replay: Replay) -> dict[str, float]:
    """CPU time and Newton iterations per IPC step."""
    ms, iterations = np.array(replay.step_ms), np.array([report.newton_iterations for report in replay.reports])
    return {
        "ipc_steps": len(replay.reports),
        "mean_ms": float(ms.mean()),
        "median_ms": float(np.median(ms)),
        "p99_ms": float(np.percentile(ms, 99)),
        "mean_reset_ms": float(np.mean(replay.reset_ms)),
        "mean_newton_iterations": float(iterations.mean()),
        "most_newton_iterations": int(iterations.max()),
        "physics_cpu_s": replay.env.physics_cpu_s,
    }


def convergence(reports: list[StepReport]) -> dict[str, Any]:
    """How steps ended and what they left."""
    return {
        "status": dict(Counter(str(report.status) for report in reports)),
        "largest_residual_n": max(report.residual_n for report in reports),
        "median_residual_n": float(np.median([report.residual_n for report in reports])),
        "largest_net_force_n": max(report.net_force_n for report in reports),
        "smallest_gap_m": min(report.smallest_gap_m for report in reports),
        "smallest_det_f": min(report.smallest_det_f for report in reports),
    }


def agreement(rows: list[tuple[int, float, float]]) -> dict[str, dict[str, float]]:
    """Deviation from the settled states by env step, from (env step, deviation, spread) [mm]."""
    result = {}
    for n in (1, 2, 3):
        deviation = np.array([d for step, d, _ in rows if step == n])
        certain = np.array([d for step, d, spread in rows if step == n and spread < AGREEMENT_MM])
        result[f"env_step_{n}"] = {
            "episodes": len(deviation),
            "median_mm": float(np.median(deviation)),
            "largest_mm": float(deviation.max()),
            "certain_episodes": len(certain),
            "part_within_0.03_mm": float((certain <= AGREEMENT_MM).mean()),
        }
    return result


def main() -> None:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("reference_dir", type=Path)
    parser.add_argument("--episodes", type=int, default=90)
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    folder: Path = arguments.reference_dir
    log = (folder / "logs" / "track1_peg_insertion.repeat0.jsonl").read_text().splitlines()
    truth = {e["episode"]: e["steps"] for e in json.loads((folder / "physics_truth.json").read_text())["episodes"]}
    replay = Replay(folder / "assets" / "track1")
    rows = []
    for line in log[: arguments.episodes]:
        episode: Episode = json.loads(line)
        motions = replay.play(episode)
        for motion, settled in zip(motions, truth.get(episode["episode"], []), strict=False):
            spread = max(settled["spread_tolerance_mm"], settled["spread_coplanar_edges_mm"])
            rows.append((settled["n"], float(np.abs(motion - settled["S_mm"]).max()), spread))
    result = {"speed": speed(replay), "convergence": convergence(replay.reports), "agreement": agreement(rows)}
    text = json.dumps(result, indent=1)
    sys.stdout.write(text + "\n")
    if arguments.json:
        arguments.json.write_text(text + "\n")


if __name__ == "__main__":
    main()
