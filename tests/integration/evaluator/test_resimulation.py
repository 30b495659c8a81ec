"""The organizers' actions through our physics on their meshes, against the independent solution of the same model."""

import json
from pathlib import Path

import pytest
from vitac.cli import main as cli


def test_first_env_steps_agree_with_the_settled_truth(
    reference_dir: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lines = (reference_dir / "logs" / "track1_peg_insertion.repeat0.jsonl").read_text().splitlines()[:3]
    recording, report = tmp_path / "recorded.jsonl", tmp_path / "report.json"
    recording.write_text("\n".join(lines) + "\n")
    assets = reference_dir / "assets" / "track1"
    with pytest.raises(SystemExit) as exit_:
        cli.main(
            ["resimulate", str(recording), "--task", "peg-insertion", "--assets", str(assets), "--json", str(report)]
        )
    assert exit_.value.code == 0
    assert capsys.readouterr().out.startswith("Episode 1: cuboid at -4 -4 -8\n")
    content = json.loads(report.read_text())
    assert set(content) == {"episodes", "solver_version", "ipc_steps", "cpu_s_per_ipc_step"}
    truth = json.loads((reference_dir / "physics_truth.json").read_text())["episodes"][:3]
    for ours, settled in zip(content["episodes"], truth, strict=True):
        assert len(ours["steps"]) == len(settled["steps"])
        assert ours["steps"][0]["surface_diff_mm"] == pytest.approx(settled["steps"][0]["S_mm"], abs=0.03)
        assert ours["steps"][0]["peg_relative_z_mm"] == pytest.approx(
            settled["steps"][0]["peg_relative_z_mm"], abs=0.05
        )


def test_logged_success_of_the_lock_is_one_here(
    reference_dir: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    line = (reference_dir / "logs" / "track1_open_lock.repeat0.jsonl").read_text().splitlines()[0]
    recording, report = tmp_path / "recorded.jsonl", tmp_path / "report.json"
    recording.write_text(line + "\n")
    with pytest.raises(SystemExit) as exit_:
        cli.main(["resimulate", str(recording), "--task", "lock-opening", "--json", str(report)])
    assert exit_.value.code == 0
    assert "success at env step 7 | recorded success after 7 env steps" in capsys.readouterr().out
    (episode,) = json.loads(report.read_text())["episodes"]
    # The key hangs free in its lock and follows the gripper, which lifts it by 1.5 mm and, from step 5 on, 1 mm a step.
    heights_mm = [min(step["tooth_z_mm"]) for step in episode["steps"]]
    assert heights_mm[2:] == pytest.approx([30.5, 30.74, 31.74, 32.74, 33.74], abs=0.02)
