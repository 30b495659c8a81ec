"""Rules about the names in a submission, on names alone."""

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from vitac.evaluator.agent.limits import Limits
from vitac.evaluator.submission.names import (
    ArchiveFault,
    ArchiveRejected,
    NamedEntry,
    check_names,
    describe_contents,
    is_ignored,
    listed,
)


def test_names_are_listed_in_order_and_the_rest_counted() -> None:
    assert listed(["b", "a"]) == "'a', 'b'"
    assert listed([]) == "nothing"
    assert listed(f"{number:02}" for number in range(23)).endswith("'19' and 3 more")
    assert len(listed(["x" * 500])) == 80


def test_contents_of_a_folder_are_what_a_submission_takes_from_it(tmp_path: Path) -> None:
    assert describe_contents(tmp_path / "gone") == f"folder {tmp_path / 'gone'} does not exist"
    for name in ("submission.yml", ".DS_Store", "\n"):
        (tmp_path / name).touch()
    assert describe_contents(tmp_path) == f"folder {tmp_path} holds '\\n', 'submission.yml'"


LIMITS = Limits(archive_files=6, archive_depth=3)


def files(*paths: str) -> list[NamedEntry]:
    return [NamedEntry(path=path, is_folder=False) for path in paths]


def folder(path: str) -> NamedEntry:
    return NamedEntry(path=path, is_folder=True)


def fault(*entries: NamedEntry) -> ArchiveFault:
    with pytest.raises(ArchiveRejected) as rejection:
        check_names(entries, LIMITS)
    assert rejection.value.message == str(rejection.value)
    return rejection.value.code


@pytest.mark.parametrize(
    ("path", "code"),
    [
        ("/etc/passwd", ArchiveFault.ABSOLUTE_PATH),
        ("C:/windows", ArchiveFault.ABSOLUTE_PATH),
        ("C:policy.py", ArchiveFault.ABSOLUTE_PATH),
        ("../policy.py", ArchiveFault.PARENT_PATH),
        ("a/../b", ArchiveFault.PARENT_PATH),
        ("a/./b", ArchiveFault.PARENT_PATH),
        ("a//b", ArchiveFault.PARENT_PATH),
        ("", ArchiveFault.PARENT_PATH),
        ("a\\b", ArchiveFault.BAD_CHARACTERS),
        ("a\nb", ArchiveFault.BAD_CHARACTERS),
        ("a\x00b", ArchiveFault.BAD_CHARACTERS),
        ("pol\u202eicy", ArchiveFault.BAD_CHARACTERS),
        ("a\u2028b", ArchiveFault.BAD_CHARACTERS),
        ("zero\u200bwidth", ArchiveFault.BAD_CHARACTERS),
        ("\ud800", ArchiveFault.BAD_CHARACTERS),
        ("a/b/c/d/e", ArchiveFault.TOO_DEEP),
        ("x" * 256, ArchiveFault.NAME_TOO_LONG),
        ("é" * 128, ArchiveFault.NAME_TOO_LONG),
    ],
)
def test_each_rule_about_one_path_has_its_code(path: str, code: ArchiveFault) -> None:
    assert fault(*files(path)) is code


@pytest.mark.parametrize("path", ["a/b/c/d", "x" * 255, "é" * 127 + "x", "a b", "..a", "a..", "…", "日本.py"])
def test_what_the_rules_just_allow_passes(path: str) -> None:
    check_names(files(path), LIMITS)


def test_a_path_of_a_thousand_bytes_passes_and_not_one_more() -> None:
    limits = Limits(archive_depth=4)
    path = "/".join(["x" * 255] * 3 + ["x" * 254, "y"])
    assert len(path) == 1024
    check_names(files(path), limits)
    with pytest.raises(ArchiveRejected) as rejection:
        check_names(files(f"{path}y"), limits)
    assert rejection.value.code is ArchiveFault.NAME_TOO_LONG


def test_a_file_twice_is_a_duplicate_and_a_folder_twice_is_not() -> None:
    assert fault(*files("a", "a")) is ArchiveFault.DUPLICATE
    assert fault(folder("a"), *files("a")) is ArchiveFault.DUPLICATE
    check_names([folder("a"), folder("a"), *files("a/b")], LIMITS)


@pytest.mark.parametrize("entries", [files("a", "a/b"), files("a/b", "a"), files("a/b", "a/b/c")])
def test_a_file_cannot_be_a_folder_too(entries: list[NamedEntry]) -> None:
    assert fault(*entries) is ArchiveFault.DUPLICATE


@pytest.mark.parametrize(
    ("first", "second"),
    [("Policy.py", "policy.py"), ("A/b", "a/c"), ("caf\u00e9", "cafe\u0301"), ("stra\u00dfe", "STRASSE")],
)
def test_names_that_a_file_system_may_confuse_are_refused(first: str, second: str) -> None:
    assert fault(*files(first, second)) is ArchiveFault.CASE_DUPLICATE


def test_folders_count_and_so_do_those_that_paths_imply() -> None:
    check_names(files("a/1", "a/2", "a/3", "a/4", "a/5"), LIMITS)
    assert fault(*files("a/1", "a/2", "a/3", "a/4", "a/5", "a/6")) is ArchiveFault.TOO_MANY_FILES
    assert fault(*files("a/1", "b/1", "c/1", "d/1")) is ArchiveFault.TOO_MANY_FILES
    check_names([*map(folder, "abcdef")], LIMITS)
    assert fault(*map(folder, "abcdefg")) is ArchiveFault.TOO_MANY_FILES


def test_a_long_name_is_cut_in_the_message() -> None:
    with pytest.raises(ArchiveRejected) as rejection:
        check_names(files("x" * 100_000), LIMITS)
    assert len(rejection.value.message) < 300


@pytest.mark.parametrize(
    ("path", "ignored"),
    [
        (".DS_Store", True),
        ("Track_1/Thumbs.db", True),
        ("Track_1/__pycache__/policy.cpython-311.pyc", True),
        ("policy.pyc", True),
        ("__MACOSX/._policy.py", True),
        (".git/config", True),
        ("a/.venv/b/c", True),
        ("policy.py", False),
        ("git/config", False),
        ("DS_Store", False),
        ("a.pyc/b.py", False),
        ("thumbs.db.txt", False),
    ],
)
def test_caches_and_desktop_files_are_ignored(path: str, ignored: bool) -> None:
    assert is_ignored(path) is ignored


@given(st.lists(st.text(alphabet="aAb/.\\\u0301", min_size=1, max_size=6), max_size=6))
def test_accepted_paths_are_distinct_on_every_file_system(paths: list[str]) -> None:
    try:
        check_names(files(*paths), LIMITS)
    except ArchiveRejected:
        return
    assert len({path.casefold() for path in paths}) == len(paths)
    assert not any(part in ("", ".", "..") for path in paths for part in path.split("/"))
