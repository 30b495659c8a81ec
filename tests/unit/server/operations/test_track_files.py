"""Track files of the organizers' own travel with a backup."""

from pathlib import Path
from typing import Any

import pytest
from pydantic import ValidationError
from vitac.evaluator.strict_model import DocumentRejected
from vitac.server.operations.backup import (
    BackupDescription,
    BackupRejected,
    missing_track_files,
    own_track_files,
    put_back,
)

DESCRIBED: dict[str, Any] = {
    "made_at": "2031-01-01T00:00:00Z",
    "release": "1",
    "schema_revision": "1",
    "dump_sha256": "",
    "blobs": (),
}
FILES = {"mine": "name: mine\r\n", "yours": "name: yours # \u00fc\n"}


def _cut_off(*_: object) -> None:
    raise KeyboardInterrupt


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    folder = tmp_path / "new" / "tracks"
    monkeypatch.setenv("VITAC_TRACKS_DIR", str(folder))
    return folder


def test_files_come_back_as_they_were_into_a_new_folder_and_once(folder: Path) -> None:
    assert own_track_files() == {}
    put_back(missing_track_files(FILES))
    assert own_track_files() == FILES
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == {
        f"{name}.yaml": content.encode() for name, content in FILES.items()
    }, "to the byte, as the evaluator's version counts them"
    assert missing_track_files(FILES) == {}
    (folder / "mine.yaml").unlink()
    assert missing_track_files(FILES) == {folder / "mine.yaml": FILES["mine"]}


def test_a_restore_that_was_cut_off_can_be_repeated(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as cut_off:
        cut_off.setattr(Path, "replace", _cut_off)
        with pytest.raises(KeyboardInterrupt):
            put_back(missing_track_files(FILES))
    assert own_track_files() == {}
    put_back(missing_track_files(FILES))
    assert own_track_files() == FILES


def test_another_file_is_never_overwritten(folder: Path) -> None:
    folder.mkdir(parents=True)
    (folder / "mine.yaml").write_text("name: mine # changed\n")
    with pytest.raises(BackupRejected, match=r"mine\.yaml in .* is another one than the backup's"):
        missing_track_files(FILES)
    assert (folder / "mine.yaml").read_text() == "name: mine # changed\n"


def test_a_service_without_a_folder_for_them_is_told_to_name_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("VITAC_TRACKS_DIR", raising=False)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "stray.yaml").write_text("name: stray\n")
    assert own_track_files() == {}
    assert missing_track_files({}) == {}
    with pytest.raises(BackupRejected, match=r"\(mine, yours\).*name one in VITAC_TRACKS_DIR"):
        missing_track_files(FILES)


@pytest.mark.parametrize("name", ["pegs-2026.1", "gr\u00f6\u00dfe", "a+b", "x:1", "..", "p" * 100, "\u00fc" * 100])
def test_every_name_that_a_track_may_have_comes_back(folder: Path, name: str) -> None:
    files = {name: f"name: {name}\n"}
    folder.mkdir(parents=True)
    (folder / f"{name}.yaml").write_text(files[name], encoding="utf-8", newline="")
    assert own_track_files() == files
    described = BackupDescription.model_validate(DESCRIBED | {"track_files": own_track_files()})
    read = BackupDescription.model_validate_json(described.model_dump_json())
    assert read.track_files == files
    (folder / f"{name}.yaml").unlink()
    put_back(missing_track_files(read.track_files))
    assert [path.name for path in folder.iterdir()] == [f"{name}.yaml"]
    assert own_track_files() == files


def test_what_cannot_be_a_track_file_is_named_instead_of_left_out(folder: Path) -> None:
    folder.mkdir(parents=True)
    for name, content in (("a b", b""), ("p" * 101, b""), ("latin", b"name: gr\xf6\xdfe"), ("\udcff", b"")):
        path = folder / f"{name}.yaml"
        path.write_bytes(content)
        with pytest.raises(DocumentRejected, match=r"\.yaml' is no track file") as refused:
            own_track_files()
        assert str(refused.value).isprintable(), "a name of other bytes than UTF-8 can be shown"
        path.unlink()
    (folder / "mine.yaml").mkdir()
    with pytest.raises(DocumentRejected, match=r"mine\.yaml' cannot be read: Is a directory"):
        own_track_files()


def test_a_file_that_the_backup_has_not_is_refused_as_it_changes_the_version(folder: Path) -> None:
    put_back(missing_track_files(FILES))
    (folder / "later.yaml").write_text("name: later\n")
    for files, further in ((FILES, "later"), ({}, "later.yaml, mine.yaml, yours")):
        with pytest.raises(BackupRejected, match=rf"got {further}\.yaml too.*another evaluator version"):
            missing_track_files(files)
    (folder / "later.yaml").unlink()
    assert missing_track_files(FILES) == {}


def test_a_backup_from_before_track_files_were_kept_takes_the_folder_as_it_is(folder: Path) -> None:
    assert BackupDescription.model_validate(DESCRIBED).track_files is None
    folder.mkdir(parents=True)
    (folder / "mine.yaml").write_text(FILES["mine"])
    assert missing_track_files(None) == {}


def test_a_folder_that_cannot_be_written_is_named(folder: Path) -> None:
    folder.parent.write_text("a file")
    with pytest.raises(BackupRejected, match="cannot be written"):
        put_back(missing_track_files(FILES))


@pytest.mark.parametrize("name", ["../mine", "/etc/mine", "", "a/b", "mine\n"])
def test_a_name_that_leads_out_of_the_folder_is_refused(name: str) -> None:
    with pytest.raises(ValidationError, match="track_files"):
        BackupDescription.model_validate(DESCRIBED | {"track_files": {name: ""}})
