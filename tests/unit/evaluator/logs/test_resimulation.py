import json
from typing import Any

import numpy as np
import pytest
from evaluation_fakes import FakeEnvironment, small_track
from vitac.evaluator.logs.recordings import Recording
from vitac.evaluator.logs.resimulation import report, reported_step, resimulate_all
from vitac.evaluator.tracks import load_track

TASK = small_track().tasks["peg-insertion"]
LOCK = load_track("track_1").tasks["lock-opening"]


def recording(number: int, *xs: float) -> Recording:
    return Recording(
        episode=TASK.episodes[number - 1],
        actions=np.array([[x, 0, 0] for x in xs], dtype=np.float32),
        infos=tuple({} for _ in xs),
        success=False,
    )


def test_report_tells_steps_ends_and_cost() -> None:
    env = FakeEnvironment()
    played = [episode for _, episode in resimulate_all(env, TASK, [recording(1, 0.5, 1.0), recording(2, 0.5)])]
    content = json.loads(report(env, played).model_dump_json(exclude_unset=True))
    assert content == {
        "episodes": [
            {
                "episode": 1,
                "steps": [
                    {"n": 1, "surface_diff_mm": [1, 2], "is_success": False},
                    {"n": 2, "surface_diff_mm": [1, 2], "is_success": True},
                ],
                "success": True,
                "end_step": 2,
                "end_reason": "success",
            },
            {
                "episode": 2,
                "steps": [{"n": 1, "surface_diff_mm": [1, 2], "is_success": False}],
                "success": False,
                "end_step": None,
                "end_reason": None,
            },
        ],
        "solver_version": "fake",
        "ipc_steps": 2 * 4 + 3 * 3,
        "cpu_s_per_ipc_step": (2 * 0.25 + 3 * 0.5) / 17,
    }


def test_empty_recording_costs_nothing() -> None:
    assert report(FakeEnvironment(), []).cpu_s_per_ipc_step == 0


def test_step_turns_metres_into_millimetres_and_keeps_millimetres() -> None:
    info = {"surface_diff_m": [0.00065, 0.001], "peg_relative_z_mm": [0.5, -0.25], "error_too_large": True, "other": 1}
    step = reported_step(TASK, 3, info)  # type: ignore[arg-type]
    assert step.model_dump(exclude_unset=True) == {
        "n": 3,
        "surface_diff_mm": (0.65, 1.0),
        "peg_relative_z_mm": (0.5, -0.25),
        "error_too_large": True,
    }


def test_step_of_a_lock_holds_the_lowest_corner_of_each_tooth() -> None:
    rear = [[0.03, 0.003, 0.0301], [0.03, -0.003, 0.0299]]
    front = [[0.01, 0.003, 0.0310], [0.01, -0.003, 0.0312]]
    info: Any = {"key1_pts_m": rear, "key2_pts_m": front}
    assert reported_step(LOCK, 1, info).measures == {"tooth_z_mm": pytest.approx((29.9, 31.0))}
    assert reported_step(LOCK, 1, {"key1_pts_m": info["key1_pts_m"]}).measures == {}
