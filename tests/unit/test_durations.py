import csv
import subprocess
import sys
from pathlib import Path


def test_a_run_keeps_how_long_each_phase_of_each_test_took(repository: Path, tmp_path: Path) -> None:
    kept = tmp_path / "folder" / "durations.csv"
    command = [sys.executable, "-m", "pytest", "-q", f"--durations-csv={kept}", "tests/unit/documents/test_limits.py"]
    run = subprocess.run(command, cwd=repository, capture_output=True, text=True, check=True)
    with kept.open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert {row["phase"] for row in rows} == {"setup", "call", "teardown"}
    assert all(row["test"].startswith("tests/unit/documents/test_limits.py::") for row in rows)
    seconds = [float(row["seconds"]) for row in rows]
    assert seconds == sorted(seconds, reverse=True)
    assert str(kept) in run.stdout
