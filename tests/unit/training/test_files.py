"""Files of a run: whole or not there, and damage is found."""

import errno
import os
import subprocess
from pathlib import Path

import numpy as np
import pytest
from vitac.training.files import FileDamaged, NotSaved, digest, load, remove_leftovers, save, write_text

ARRAYS = {"actions": np.arange(6, dtype=np.float32).reshape(2, 3), "solved": np.array([True, False])}


def test_what_was_saved_is_loaded(tmp_path: Path) -> None:
    path = tmp_path / "new folder" / "episodes.npz"
    save(path, ARRAYS)
    found = load(path)
    assert sorted(found) == sorted(ARRAYS)
    for name, array in ARRAYS.items():
        np.testing.assert_array_equal(found[name], array)
        assert found[name].dtype == array.dtype
    assert [each.name for each in path.parent.iterdir()] == ["episodes.npz"]


def test_equal_arrays_make_equal_files(tmp_path: Path) -> None:
    for name in ("one.npz", "other.npz"):
        save(tmp_path / name, ARRAYS)
    assert (tmp_path / "one.npz").read_bytes() == (tmp_path / "other.npz").read_bytes()


@pytest.mark.parametrize("damage", [b"", b"no archive", None])
def test_damage_is_found(tmp_path: Path, damage: bytes | None) -> None:
    path = tmp_path / "episodes.npz"
    save(path, ARRAYS)
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2] if damage is None else damage)
    with pytest.raises(FileDamaged, match=r"episodes.npz cannot be read .*; delete it and run it again"):
        load(path)


def test_file_with_other_numbers_is_found(tmp_path: Path) -> None:
    path = tmp_path / "episodes.npz"
    changed = {**ARRAYS, "actions": ARRAYS["actions"] + 1}
    np.savez(path, **changed, digest=np.array(digest(ARRAYS)))  # type: ignore[arg-type]
    with pytest.raises(FileDamaged, match="does not hold what was written"):
        load(path)


def test_file_that_nobody_saved_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "episodes.npz"
    np.savez(path, **ARRAYS)  # type: ignore[arg-type]
    with pytest.raises(FileDamaged):
        load(path)


def test_full_disk_keeps_what_was_saved_before(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "episodes.npz"
    save(path, ARRAYS)
    before = path.read_bytes()

    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(NotSaved, match=r"cannot be written \(No space left on device\); free some space"):
        save(path, {"actions": np.zeros(3)})
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


def test_stopping_in_the_middle_keeps_what_was_saved_before(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "episodes.npz"
    save(path, ARRAYS)
    before = path.read_bytes()

    def stop(_: int) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(os, "fsync", stop)
    with pytest.raises(KeyboardInterrupt):
        save(path, {"actions": np.zeros(3)})
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


def test_folder_that_cannot_be_made_is_told(tmp_path: Path) -> None:
    (tmp_path / "taken").write_text("a file")
    with pytest.raises(NotSaved, match=r"taken/log.jsonl cannot be written \(File exists\); give a folder that can be"):
        write_text(tmp_path / "taken" / "log.jsonl", "text")


def test_text_is_replaced_as_a_whole(tmp_path: Path) -> None:
    path = tmp_path / "log.jsonl"
    for text in ("first\n", "second\n"):
        write_text(path, text)
        assert path.read_text() == text


def test_leftovers_of_processes_that_are_no_more_are_removed_and_nothing_else(tmp_path: Path) -> None:
    ended = subprocess.Popen(["true"])
    ended.wait()
    dead = {f".round-001.npz.{ended.pid}.new", f".log.jsonl.{os.getpid()}.new", f".log.jsonl.{'9' * 30}.new"}
    kept = {f".log.jsonl.{os.getppid()}.new", f".log.jsonl.{ended.pid}.new.bak", ".mine.new", ".1.new", "log.jsonl"}
    for name in dead | kept:
        (tmp_path / name).write_bytes(b"half")
    folder = f".folder.{ended.pid}.new"
    (tmp_path / folder).mkdir()
    remove_leftovers(tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == kept | {folder}
    remove_leftovers(tmp_path / "nowhere")


def test_half_of_a_file_that_a_kill_leaves_is_a_leftover(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Path, "unlink", lambda *_, **__: None)  # like a kill

    def stop(_: int) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(os, "fsync", stop)
    with pytest.raises(KeyboardInterrupt):
        save(tmp_path / "round-001.npz", ARRAYS)
    monkeypatch.undo()
    assert len(list(tmp_path.iterdir())) == 1
    remove_leftovers(tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_digest_tells_names_types_shapes_and_values_apart() -> None:
    arrays: list[dict[str, np.ndarray]] = [
        {"a": np.zeros(4, dtype=np.float32)},
        {"b": np.zeros(4, dtype=np.float32)},
        {"a": np.zeros(4, dtype=np.int32)},
        {"a": np.zeros((2, 2), dtype=np.float32)},
        {"a": np.ones(4, dtype=np.float32)},
    ]
    assert len({digest(each) for each in arrays}) == len(arrays)
