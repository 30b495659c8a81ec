"""Books against the organizers' log: offsets and relative motion depend on the actions alone, not on the physics."""

import json
from pathlib import Path

import numpy as np
import pytest
from vitac.envs.tasks.peg_insertion.env import PegInsertionEnv

# The log prints actions with eight digits, and up to eight env steps add up.
LARGEST_DEVIATION_MM_DEG = 5e-8


@pytest.mark.usefixtures("fake_scenes")
def test_offsets_and_relative_motion_are_the_logged_ones(reference_dir: Path) -> None:
    lines = (reference_dir / "logs" / "track1_peg_insertion.repeat0.jsonl").read_text().splitlines()
    env = PegInsertionEnv()
    deviations = []
    for episode in map(json.loads, lines):
        env.reset(options={"shape": episode["shape"], "offset_mm_deg": episode["initial_offset"]})
        for step in episode["steps"]:
            observation, *_, info = env.step(np.array(step["action"], dtype=np.float32))
            deviations.append(info["gt_offset_mm_deg"] - step["gt_offset_mm_deg"])
            deviations.append(info["relative_motion_mm_deg"][:3] - step["relative_motion_mm_deg"][:3])
            assert info["relative_motion_mm_deg"][3] == step["relative_motion_mm_deg"][3]
            assert observation["relative_motion"] == pytest.approx(step["relative_motion_mm_deg"], rel=1.2e-7, abs=1e-7)
    assert len(lines) == 90
    assert np.abs(deviations).max() < LARGEST_DEVIATION_MM_DEG


@pytest.mark.usefixtures("fake_scenes")
def test_flags_and_rewards_follow_from_the_logged_measurements(
    reference_dir: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With the logged surface motion and peg heights in place of ours, every verdict of the log comes out."""
    lines = (reference_dir / "logs" / "track1_peg_insertion.repeat0.jsonl").read_text().splitlines()
    env = PegInsertionEnv()
    for episode in map(json.loads, lines):
        env.reset(options={"shape": episode["shape"], "offset_mm_deg": episode["initial_offset"]})
        for step in episode["steps"]:
            monkeypatch.setattr(env.scene, "surface_diff_m", lambda step=step: np.array(step["surface_diff_m"]))
            monkeypatch.setattr(
                env.task_scene, "peg_relative_z_mm", lambda step=step: np.array(step["peg_relative_z_mm"])
            )
            _, reward, terminated, truncated, info = env.step(np.array(step["action"], dtype=np.float32))
            for flag in ("tactile_movement_too_large", "too_many_steps", "error_too_large", "is_success"):
                assert info[flag] == step[flag], (episode["episode"], step["n"], flag)
            assert reward == pytest.approx(step["reward"], abs=3e-7)
            assert (terminated or truncated) == (step is episode["steps"][-1])
        assert terminated == (episode["result"] == "SUCCESS")
