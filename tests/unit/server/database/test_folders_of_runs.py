"""The folders of test runs: in memory only where there is some, and gone also after a run that was killed."""

import os
import time
from pathlib import Path

import databases
import pytest
from databases import (
    FOLDERS,
    NEEDED_BYTES,
    YOUNG_S,
    hold,
    place_of_folders,
    remove_left_behind,
    state_directory,
)


def folder_of(place: Path, name: str, *, age_s: float) -> Path:
    folder = place / f"{FOLDERS}{name}"
    (folder / "database").mkdir(parents=True)
    (folder / "database" / "row").write_text("1")
    os.utime(folder, times=(time.time() - age_s,) * 2)
    return folder


def test_a_run_removes_what_killed_ones_left_behind_and_nothing_else(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    elsewhere = tmp_path / "elsewhere"
    place = tmp_path / "place"
    others = folder_of(elsewhere, "others", age_s=2 * YOUNG_S)
    left, held, young = (
        folder_of(place, name, age_s=age_s)
        for name, age_s in (("left", 2 * YOUNG_S), ("held", 2 * YOUNG_S), ("young", 0.0))
    )
    link, file, unrelated = place / f"{FOLDERS}link", place / f"{FOLDERS}file", place / "unrelated"
    link.symlink_to(others)
    file.write_text("")
    unrelated.mkdir()
    os.utime(unrelated, times=(0, 0))
    handle = hold(held)
    monkeypatch.setattr(databases, "place_of_folders", lambda: place)
    own = state_directory()
    assert not left.exists()
    assert set(place.iterdir()) == {held, young, link, file, unrelated, own}
    assert (others / "database" / "row").exists()
    os.close(handle)
    os.utime(own, times=(0, 0))
    remove_left_behind.__wrapped__(place)
    assert set(place.iterdir()) == {young, link, file, unrelated, own}


def test_folders_of_other_users_stay(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    theirs = folder_of(tmp_path, "theirs", age_s=2 * YOUNG_S)
    with monkeypatch.context() as as_another:
        as_another.setattr(os, "geteuid", lambda: theirs.stat().st_uid + 1)
        remove_left_behind.__wrapped__(tmp_path)
    assert theirs.exists()
    remove_left_behind.__wrapped__(tmp_path)
    assert not theirs.exists()


@pytest.mark.parametrize(("missing_bytes", "has_room"), [(1024, False), (0, True)])
def test_folders_are_in_memory_only_where_the_machine_has_some_left(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, missing_bytes: int, has_room: bool
) -> None:
    class Disk:
        """An empty one in memory, which programs may run on."""

        f_bavail, f_frsize, f_flag = NEEDED_BYTES, 1, 0

    use = tmp_path / "meminfo"
    use.write_text(f"MemTotal:       65808284 kB\nMemAvailable:   {(NEEDED_BYTES - missing_bytes) // 1024} kB\n")
    monkeypatch.setattr(databases, "MEMORY_USE", use)
    monkeypatch.setattr(databases, "MEMORY", tmp_path)
    monkeypatch.setattr(os, "access", lambda *_: True)
    monkeypatch.setattr(os, "statvfs", lambda _: Disk)
    assert place_of_folders.__wrapped__() == (tmp_path if has_room else Path("/tmp"))
