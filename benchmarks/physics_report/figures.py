"""What the replayed episodes say about speed, convergence, agreement with settled states, and the organizers' logs."""

from collections import Counter
from typing import Any

import numpy as np
from vitac.envs.fem.scene.report import StepReport, StepStatus

from .replay import EnvStep, Reference, Replay

Figures = dict[str, Any]
# An episode counts as certain where the reference's own spread is below this, and as missed beyond it.
AGREEMENT_MM = 0.03
ENV_STEPS = (1, 2, 3)


def speed(replay: Replay) -> Figures:
    """Return the CPU time and Newton iterations per IPC step."""
    ms, iterations = np.array(replay.step_ms), np.array([report.newton_iterations for report in replay.reports])
    return {
        "episodes": len(replay.reset_ms),
        "ipc_steps": len(replay.reports),
        "mean_ms": float(ms.mean()),
        "median_ms": float(np.median(ms)),
        "p99_ms": float(np.percentile(ms, 99)),
        "mean_reset_ms": float(np.mean(replay.reset_ms)),
        "mean_newton_iterations": float(iterations.mean()),
        "mean_reusing_iterations": float(np.mean([report.reusing_iterations for report in replay.reports])),
        "max_newton_iterations": int(iterations.max()),
        "physics_cpu_s": replay.env.physics_cpu_s,
    }


def convergence(reports: list[StepReport]) -> Figures:
    """Return how IPC steps ended and what they left."""
    solved = [report for report in reports if report.status is not StepStatus.NOT_CONVERGED]
    counts = Counter(report.status for report in reports)
    return {
        "ipc_steps": len(reports),
        **{str(status): counts[status] for status in StepStatus},
        "largest_residual_n": max(report.residual_n for report in solved),
        "median_residual_n": float(np.median([report.residual_n for report in solved])),
        "largest_net_force_n": max(report.net_force_n for report in solved),
        "largest_net_torque_n_m": max(report.net_torque_n_m for report in solved),
        "smallest_gap_m": min(report.smallest_gap_m for report in solved),
        "smallest_det_f": min(report.smallest_det_f for report in solved),
    }


def deviation_mm(step: EnvStep, settled: Figures) -> float:
    """Return the largest difference of `surface_diff` of the two sensors from a settled state [mm]."""
    return float(np.abs(step.surface_diff_mm - settled["S_mm"]).max())


def spread_mm(settled: Figures) -> float:
    """Return how far the reference itself moves with its tolerance and with coplanar edges [mm]."""
    return float(max(settled["spread_tolerance_mm"], settled["spread_coplanar_edges_mm"]))


def agreement(replay: Replay, reference: Reference) -> list[Figures]:
    """Return the deviation from the settled states, by env step."""
    rows, played = [], replay.index_by_step()
    for n in ENV_STEPS:
        compared = [
            (played[key], settled) for key, settled in reference.settled.items() if key[1] == n and key in played
        ]
        if not compared:
            continue
        deviations = np.array([deviation_mm(*pair) for pair in compared])
        certain = np.array([spread_mm(settled) < AGREEMENT_MM for _, settled in compared])
        rows.append(
            {
                "env_step": n,
                "episodes": len(compared),
                "median_mm": float(np.median(deviations)),
                "largest_mm": float(deviations.max()),
                "certain_episodes": int(certain.sum()),
                "part_within": float((deviations[certain] <= AGREEMENT_MM).mean()),
            }
        )
    return rows


def misses(replay: Replay, reference: Reference) -> list[Figures]:
    """Return certain episodes whose first env steps end elsewhere than the reference's."""
    rows = []
    for key, step in replay.index_by_step().items():
        settled = reference.settled.get(key)
        if settled is None or step.n not in ENV_STEPS or spread_mm(settled) >= AGREEMENT_MM:
            continue
        if deviation_mm(step, settled) > AGREEMENT_MM:
            rows.append(
                {
                    "episode": step.episode,
                    "env_step": step.n,
                    "deviation_mm": deviation_mm(step, settled),
                    "spread_mm": spread_mm(settled),
                    "lowest_corner_mm": float(min(step.info["peg_relative_z_mm"])),
                    "reference_lowest_corner_mm": float(min(settled["peg_relative_z_mm"])),
                }
            )
    return rows


def against_logs(replay: Replay, reference: Reference) -> list[Figures]:
    """Return the same actions here and in the organizers' run of the 2025 simulator, by env step."""
    rows, played = [], replay.index_by_step()
    logged = {(e["episode"], step["n"]): step for e in reference.log for step in e["steps"]}
    for n in ENV_STEPS:
        compared = [(played[key].info, theirs) for key, theirs in logged.items() if key[1] == n and key in played]
        if not compared:
            continue
        motions_mm = 1e3 * np.array([[ours["surface_diff_m"], theirs["surface_diff_m"]] for ours, theirs in compared])
        larger_mm = motions_mm.max(axis=2)
        offsets = [np.abs(ours["gt_offset_mm_deg"] - theirs["gt_offset_mm_deg"]).max() for ours, theirs in compared]
        rows.append(
            {
                "env_step": n,
                "episodes": len(compared),
                "largest_offset_difference": float(max(offsets)),
                "median_mm": float(np.median(np.abs(motions_mm[:, 0] - motions_mm[:, 1]))),
                "larger_median_mm": float(np.median(np.abs(larger_mm[:, 0] - larger_mm[:, 1]))),
                **{f"ours_{flag}": _count(compared, 0, flag) for flag in FLAGS},
                **{f"logged_{flag}": _count(compared, 1, flag) for flag in FLAGS},
                **{f"both_{flag}": sum(bool(a[flag] and b[flag]) for a, b in compared) for flag in FLAGS},
            }
        )
    return rows


FLAGS = ("tactile_movement_too_large", "is_success")


def _count(compared: list[tuple[Figures, Figures]], side: int, flag: str) -> int:
    return sum(bool(pair[side][flag]) for pair in compared)


def outcomes(replay: Replay, reference: Reference) -> list[Figures]:
    """Return how the logged episodes ended, and how they end here under the logged actions."""
    counts: Counter[tuple[str, str]] = Counter()
    for episode in reference.log[: len(replay.reset_ms)]:
        ours = [step for step in replay.steps if step.episode == episode["episode"]]
        counts[_logged_end(episode), _our_end(ours)] += 1
    return [{"logged": logged, "ours": ours, "episodes": count} for (logged, ours), count in sorted(counts.items())]


def _logged_end(episode: Figures) -> str:
    last = episode["steps"][-1]
    if last["is_success"]:
        return "success"
    return "tactile" if last["tactile_movement_too_large"] else "steps"


def _our_end(steps: list[EnvStep]) -> str:
    for step in steps:
        if reason := step.info["end_reason"]:
            return str(reason)
    return "continues"
