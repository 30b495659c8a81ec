import os
import subprocess
from pathlib import Path

import pytest
from vitac.evaluator.agent.probe_folder import probe_folder


@pytest.fixture(autouse=True)
def _temporary_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))


def test_everybody_may_enter_and_nothing_stays(tmp_path: Path) -> None:
    with probe_folder() as folder:
        assert folder.stat().st_mode & 0o777 == 0o755
        (folder / "policy.py").write_text("")
    assert list(tmp_path.iterdir()) == []


def test_folders_of_killed_processes_go_and_those_of_others_stay(tmp_path: Path) -> None:
    ended = subprocess.Popen(["true"])
    ended.wait()
    killed, working, foreign = (
        tmp_path / name
        for name in (f"vitac-doctor-{ended.pid}-x", f"vitac-doctor-{os.getpid()}-y", "vitac-doctor-notes")
    )
    for each in (killed, working, foreign):
        each.mkdir()
    with probe_folder():
        assert not killed.exists()
        assert working.exists()
        assert foreign.exists()
