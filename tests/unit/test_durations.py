import csv
import gc
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


def test_garbage_is_looked_for_again_after_the_tests_were_collected_but_not_among_them() -> None:
    assert gc.isenabled()
    assert gc.get_freeze_count() > 10_000
