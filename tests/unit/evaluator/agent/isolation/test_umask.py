"""What was installed under umask 077: readable in memory, and from the disk refused with the remedy."""

import os
from pathlib import Path

import pytest
from vitac.evaluator.agent.isolation import bubblewrap, memory_files
from vitac.evaluator.agent.probe_folder import probe_folder
from vitac.evaluator.agent.verdicts import SandboxFailed


@pytest.fixture
def closed(tmp_path: Path) -> Path:
    before = os.umask(0o077)
    try:
        folder = tmp_path / "closed"
        (folder / "bin").mkdir(parents=True)
        (folder / "agent.py").touch()
        (folder / "bin" / "python").touch(0o700)
        (folder / "link").symlink_to("/nowhere")
    finally:
        os.umask(before)
    return folder


def test_files_in_memory_are_opened_to_all(closed: Path) -> None:
    memory_files._open_to_all(closed)
    modes = {path.name: path.stat().st_mode & 0o777 for path in (closed, *closed.rglob("*")) if not path.is_symlink()}
    assert modes == {"closed": 0o755, "bin": 0o755, "agent.py": 0o644, "python": 0o755}


def test_probes_are_readable_whatever_the_umask() -> None:
    before = os.umask(0o077)
    try:
        with probe_folder() as folder:
            (folder / "policy.py").touch()
            assert (folder / "policy.py").stat().st_mode & 0o777 == 0o644
        assert os.umask(0o077) == 0o077
    finally:
        os.umask(before)


@pytest.mark.parametrize("name", [".", "agent.py"])
def test_files_on_the_disk_are_refused_with_the_remedy(
    closed: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    monkeypatch.setattr(bubblewrap, "current_user_isolation", lambda: bubblewrap.UserIsolation.ROOT)
    with pytest.raises(SandboxFailed, match=rf"cannot read {closed}.* umask 077\). Run `chmod -R go\+rX {closed}"):
        bubblewrap._require_readable([closed / name])
    monkeypatch.setattr(bubblewrap, "current_user_isolation", lambda: bubblewrap.UserIsolation.USER_NAMESPACE)
    bubblewrap._require_readable([closed / name])
