"""The members of a backup: written in order, and read back only as they were written; without a database."""

import hashlib
import io
import json
import tarfile
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest
from vitac.server.operations.archive import (
    BLOB_FOLDER,
    DESCRIPTION_NAME,
    DUMP_NAME,
    BackupDescription,
    BackupReader,
    BackupRejected,
    BackupWriter,
)

DUMP = b"the dump of a database"
BLOBS = [b"", b"an upload", b"a longer upload" * 100_000]


def digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def description(**changes: Any) -> BackupDescription:
    return BackupDescription(
        **{
            "made_at": datetime(2025, 3, 1, tzinfo=UTC),
            "release": "0.1.0",
            "schema_revision": "v0001",
            "dump_sha256": digest(DUMP),
            "blobs": tuple(map(digest, BLOBS)),
            **changes,
        }
    )


@pytest.fixture
def backup(tmp_path: Path) -> Path:
    """A whole backup."""
    path = tmp_path / "backup.tar"
    with tarfile.open(path, "w:") as tar:
        writer = BackupWriter(tar)
        writer.describe(description())
        for name, content in {DUMP_NAME: DUMP, **{f"{BLOB_FOLDER}/{digest(blob)}": blob for blob in BLOBS}}.items():
            (tmp_path / "content").write_bytes(content)
            writer.add(name, tmp_path / "content")
    return path


Members = dict[str, bytes]


def rewrite(path: Path, change: Callable[[Members], object]) -> None:
    """Write a backup anew with changed members."""
    with tarfile.open(path) as tar:
        members = {member.name: tar.extractfile(member).read() for member in tar}  # type: ignore[union-attr]
    change(members)
    with tarfile.open(path, "w:") as tar:
        for name, content in members.items():
            member = tarfile.TarInfo(name)
            member.size = len(content)
            tar.addfile(member, io.BytesIO(content))


def test_a_backup_holds_its_description_first_then_dump_and_uploads(backup: Path) -> None:
    with tarfile.open(backup) as tar:
        names = tar.getnames()
    assert names == [DESCRIPTION_NAME, DUMP_NAME, *(f"{BLOB_FOLDER}/{digest(blob)}" for blob in BLOBS)]
    assert (DESCRIPTION_NAME, DUMP_NAME, BLOB_FOLDER) == ("backup.json", "database.dump", "blobs")


def test_what_was_written_is_read_back(backup: Path, tmp_path: Path) -> None:
    with BackupReader.opened(backup) as reader:
        assert reader.description == description()
        reader.check()
        reader.extract_dump(tmp_path / "dump")
        assert (tmp_path / "dump").read_bytes() == DUMP
        for number, blob in enumerate(BLOBS):
            reader.extract_blob(digest(blob), tmp_path / str(number))
            assert (tmp_path / str(number)).read_bytes() == blob


def test_a_description_is_json_that_people_can_read(backup: Path) -> None:
    with tarfile.open(backup) as tar:
        content = tar.extractfile(DESCRIPTION_NAME).read()  # type: ignore[union-attr]
    assert json.loads(content)["format"] == 1
    assert content.count(b"\n") > 5


def test_extracting_overwrites_nothing(backup: Path, tmp_path: Path) -> None:
    (tmp_path / "there").write_bytes(b"kept")
    with BackupReader.opened(backup) as reader:
        with pytest.raises(FileExistsError):
            reader.extract_dump(tmp_path / "there")
        with pytest.raises(FileExistsError):
            reader.extract_blob(digest(BLOBS[1]), tmp_path / "there")
    assert (tmp_path / "there").read_bytes() == b"kept"


BLOB = f"{BLOB_FOLDER}/{digest(BLOBS[1])}"


@pytest.mark.parametrize("name", [DUMP_NAME, BLOB])
def test_a_member_that_is_missing_is_named(backup: Path, name: str) -> None:
    rewrite(backup, lambda members: members.pop(name))
    with BackupReader.opened(backup) as reader, pytest.raises(BackupRejected) as refused:
        reader.check()
    assert str(refused.value) == f"The backup has no file {name}; it is incomplete."


@pytest.mark.parametrize("name", [DUMP_NAME, BLOB])
@pytest.mark.parametrize("change", [b"", b"altered"])
def test_a_member_that_was_altered_is_named_with_both_digests(backup: Path, name: str, change: bytes) -> None:
    with tarfile.open(backup) as tar:
        before = digest(tar.extractfile(name).read())  # type: ignore[union-attr]
    rewrite(backup, lambda members: members.update({name: change}))
    with BackupReader.opened(backup) as reader, pytest.raises(BackupRejected) as refused:
        reader.check()
    assert str(refused.value) == f"{name} was altered: expected SHA-256 {before}, got {digest(change)}."


def test_a_folder_in_place_of_a_member_is_none(backup: Path) -> None:
    rewrite(backup, lambda members: members.pop(DUMP_NAME))
    with tarfile.open(backup, "a:") as tar:
        folder = tarfile.TarInfo(DUMP_NAME)
        folder.type = tarfile.DIRTYPE
        tar.addfile(folder)
    with BackupReader.opened(backup) as reader, pytest.raises(BackupRejected, match=r"has no file database\.dump"):
        reader.check()


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"{}",
        b"not json",
        b"[]",
        description().model_dump_json().replace('"release"', '"version"').encode(),
    ],
)
def test_a_description_of_another_form_is_refused(backup: Path, content: bytes) -> None:
    rewrite(backup, lambda members: members.update({DESCRIPTION_NAME: content}))
    with (
        pytest.raises(BackupRejected, match=r"^backup\.json( cannot be read)?: ") as caught,
        BackupReader.opened(backup),
    ):
        pass
    assert "pydantic" not in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_backup_of_a_newer_release_names_it(backup: Path) -> None:
    newer = json.loads(description().model_dump_json()) | {"format": 2, "release": "9.1", "keys": ["added"]}
    rewrite(backup, lambda members: members.update({DESCRIPTION_NAME: json.dumps(newer).encode()}))
    said = r"^This backup has format 2, written by release 9\.1; this release reads format 1\. Restore it with that"
    with pytest.raises(BackupRejected, match=said), BackupReader.opened(backup):
        pass


def test_a_tar_file_without_a_description_is_no_backup(backup: Path) -> None:
    rewrite(backup, lambda members: members.pop(DESCRIPTION_NAME))
    with pytest.raises(BackupRejected, match=r"^The backup has no file backup\.json"), BackupReader.opened(backup):
        pass


@pytest.mark.parametrize("content", [b"", b"short", b"x" * 5000, bytes(300)])
def test_another_file_is_no_backup(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "file"
    path.write_bytes(content)
    with pytest.raises(BackupRejected), BackupReader.opened(path):
        pass


@pytest.mark.parametrize("part", [0.2, 0.6, 0.95])
def test_a_backup_that_was_cut_off_is_refused(backup: Path, part: float) -> None:
    content = backup.read_bytes()
    backup.write_bytes(content[: int(len(content) * part)])
    with pytest.raises(BackupRejected), BackupReader.opened(backup) as reader:
        reader.check()


def test_a_compressed_backup_is_refused_with_what_is_expected(backup: Path, tmp_path: Path) -> None:
    packed = tmp_path / "backup.tar.gz"
    with tarfile.open(packed, "w:gz") as tar:
        tar.add(backup)
    with pytest.raises(BackupRejected, match="Expected a file of `vitac admin backup`"), BackupReader.opened(packed):
        pass
