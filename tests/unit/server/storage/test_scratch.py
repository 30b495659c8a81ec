import errno
import fcntl
import signal
import socket
import subprocess
import sys
from pathlib import Path

import pytest
from vitac.server.storage.scratch import remove_leftovers, scratch_folder

HOLDER = """
import sys, time
from pathlib import Path
from vitac.server.storage.scratch import scratch_folder
with scratch_folder(Path(sys.argv[1]), "worker") as folder:
    (folder / "unpacked").mkdir()
    print(folder, flush=True)
    time.sleep(600)
"""


def test_a_folder_is_gone_with_its_block(tmp_path: Path) -> None:
    with scratch_folder(tmp_path / "scratch", "upload") as folder:
        (folder / "half").write_bytes(b"half")
        assert folder.name.startswith("upload-")
        assert folder.stat().st_mode & 0o777 == 0o700
    assert list((tmp_path / "scratch").iterdir()) == []


def test_only_the_folder_of_a_process_that_is_gone_is_removed(tmp_path: Path) -> None:
    with (
        subprocess.Popen([sys.executable, "-c", HOLDER, str(tmp_path)], stdout=subprocess.PIPE, text=True) as other,
        scratch_folder(tmp_path, "worker") as mine,
    ):
        assert other.stdout is not None
        theirs = Path(other.stdout.readline().rstrip())
        remove_leftovers(tmp_path)
        assert sorted(tmp_path.iterdir()) == sorted([mine, theirs])
        other.send_signal(signal.SIGKILL)
        other.wait()
        remove_leftovers(tmp_path)
        assert list(tmp_path.iterdir()) == [mine]


def test_what_others_have_in_the_folder_is_left_alone(tmp_path: Path) -> None:
    host = socket.gethostname()
    names = ["worker-elsewhere-x", f"worker-{host}-9-x", f"{host}-x", "notes"]
    for name in names:
        (tmp_path / name).mkdir()
    file = tmp_path / f"upload-{host}-x"
    file.touch()
    remove_leftovers(tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted([*names, file.name])
    remove_leftovers(tmp_path / "absent")


def test_where_folders_cannot_be_locked_they_stay(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(descriptor: int, operation: int) -> None:
        raise OSError(errno.EBADF, "flock")

    monkeypatch.setattr(fcntl, "flock", refused)
    with scratch_folder(tmp_path, "upload") as folder:
        remove_leftovers(tmp_path)
        assert folder.is_dir()
    assert not folder.exists()
