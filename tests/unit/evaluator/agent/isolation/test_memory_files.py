import fcntl
import os
from pathlib import Path

import pytest
from vitac.evaluator.agent.isolation import memory_files
from vitac.evaluator.agent.isolation.packages import Interpreter, find_interpreter
from vitac.evaluator.agent.verdicts import SandboxFailed


@pytest.fixture
def memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder that counts as a tmpfs, and a small system to be copied into it."""
    monkeypatch.setenv("VITAC_MEMORY_DIR", str(tmp_path))
    monkeypatch.setattr(memory_files, "_file_system", lambda _: "tmpfs")
    monkeypatch.setattr(memory_files, "_PROGRAMS", ("true",))
    monkeypatch.setattr(memory_files, "_copy_system_python", lambda *_: None)
    memory_files._prepare.cache_clear()
    return tmp_path


def small_interpreter(folder: Path, word: str) -> Interpreter:
    (folder / "package").mkdir(exist_ok=True)
    (folder / "package" / f"{word}.py").write_text(word)
    binds = ((folder / "package", Path("/opt/vitac/packages/0/package")),)
    found = find_interpreter()
    return Interpreter(executable=found.executable, packages=(), library_folder=None, read_only_binds=binds, masked=())


def prepare(folder: Path, word: str) -> Path:
    memory_files._prepare.cache_clear()
    return memory_files.prepare_system_files(small_interpreter(folder, word), own=())


def test_programs_come_with_their_libraries_and_packages_at_their_places(memory: Path, tmp_path: Path) -> None:
    root = prepare(tmp_path, "one")
    assert (root / "opt/vitac/packages/0/package/one.py").read_text() == "one"
    assert os.access(root / "usr/bin/true", os.X_OK)
    assert any(path.name.startswith("libc.so") for path in root.rglob("libc.so*"))
    assert memory_files.mount_point(root).is_dir()


def test_folders_of_others_stay_while_they_are_used_and_go_afterwards(
    memory: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    held: list[int] = []
    opened = os.open

    def open_and_hold(path: Path, flags: int, mode: int = 0o777) -> int:
        descriptor = opened(path, flags, mode)
        held.append(descriptor)
        return descriptor

    with monkeypatch.context() as patch:
        patch.setattr(os, "open", open_and_hold)
        first = prepare(tmp_path, "one")
    second = prepare(tmp_path, "two")
    assert first != second
    assert first.exists(), "a process still uses it"
    for descriptor in held:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_UN)
        except OSError:
            continue  # of a lock that was closed
    prepare(tmp_path, "three")
    assert not first.exists()


def test_a_half_filled_folder_is_filled_again(memory: Path, tmp_path: Path) -> None:
    root = prepare(tmp_path, "one")
    (root.parent / "complete").unlink()
    (root / "usr/bin/true").unlink()
    assert (prepare(tmp_path, "one") / "usr/bin/true").exists()


def test_a_folder_that_somebody_else_may_write_is_refused(memory: Path, tmp_path: Path) -> None:
    root = prepare(tmp_path, "one")
    root.parent.chmod(0o777)
    with pytest.raises(SandboxFailed, match="belongs to somebody else"):
        prepare(tmp_path, "one")


def test_a_full_memory_says_how_much_is_left(memory: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(memory_files, "_copy_libraries", refuse)
    with pytest.raises(SandboxFailed, match=r"No space left on device.*MiB left.*VITAC_MEMORY_DIR"):
        prepare(tmp_path, "one")
