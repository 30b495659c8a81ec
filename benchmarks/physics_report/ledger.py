"""Accuracy against speed: the same episodes with other solver settings, compared with the tightest of them."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
from vitac.envs.fem.model.settings import SolverSettings
from vitac.envs.fem.scene.report import StepStatus

from .figures import AGREEMENT_MM, deviation_mm, spread_mm
from .replay import Reference, Replay

Row = dict[str, Any]
TIGHTEST = "tightest"


def settings() -> Iterator[tuple[str, SolverSettings]]:
    """Return the names and settings, the tightest first; a tolerance of 1 m or 1 N decides nothing."""
    standard = SolverSettings()
    yield TIGHTEST, replace(standard, step_tolerance_m=1e-11, residual_tolerance_n=1e-7)
    yield "standard", standard
    for move_m in (1e-4, 1e-5, 1e-6, 1e-7, 1e-9):
        yield f"move {move_m:.0e} m alone", replace(standard, step_tolerance_m=move_m, residual_tolerance_n=1.0)
    for force_n in (1e-1, 1e-2, 1e-3, 1e-5):
        yield f"force {force_n:.0e} N alone", replace(standard, step_tolerance_m=1.0, residual_tolerance_n=force_n)
    for level in (1, 2):
        yield f"every motion in {2**level} parts", replace(standard, first_division_level=level)


def ledger(reference: Reference, *, episodes: int, env_steps: int) -> list[Row]:
    """Play the first episodes once per setting."""
    rows: list[Row] = []
    tightest: dict[tuple[int, int], np.ndarray[Any, Any]] = {}
    for name, solver in settings():
        replay = Replay(reference.assets_dir, solver)
        for episode in reference.log[:episodes]:
            replay.play(episode, first_steps=env_steps)
        played = {key: step.surface_diff_mm for key, step in replay.index_by_step().items()}
        if name == TIGHTEST:
            tightest = played
        shared = sorted(played.keys() & tightest.keys())
        differences = np.array([np.abs(played[key] - tightest[key]).max() for key in shared])
        rows.append({"setting": name, **_cost(replay), **_spread(differences), **_truth(replay, reference)})
    return rows


def _cost(replay: Replay) -> Row:
    statuses = [report.status for report in replay.reports]
    return {
        "step_tolerance_m": replay.solver.step_tolerance_m,
        "residual_tolerance_n": replay.solver.residual_tolerance_n,
        "mean_ms": float(np.mean(replay.step_ms)),
        "mean_newton_iterations": float(np.mean([report.newton_iterations for report in replay.reports])),
        "not_converged": statuses.count(StepStatus.NOT_CONVERGED),
    }


def _spread(differences_mm: np.ndarray[Any, Any]) -> Row:
    return {
        "env_steps": len(differences_mm),
        "median_mm": float(np.median(differences_mm)),
        "p90_mm": float(np.percentile(differences_mm, 90)),
        "largest_mm": float(differences_mm.max()),
        "elsewhere": int((differences_mm > AGREEMENT_MM).sum()),
    }


def _truth(replay: Replay, reference: Reference) -> Row:
    """Return the deviation from the settled states that are certain."""
    found = [
        deviation_mm(step, reference.settled[key])
        for key, step in replay.index_by_step().items()
        if key in reference.settled and spread_mm(reference.settled[key]) < AGREEMENT_MM
    ]
    return {
        "truth_env_steps": len(found),
        "truth_median_mm": float(np.median(found)),
        "truth_part_within": float((np.array(found) <= AGREEMENT_MM).mean()),
    }
