import hashlib
import os
import zipfile
from pathlib import Path

import pytest
from submissions import MANIFEST
from vitac.cli.client.pieces import pack
from vitac.evaluator.submission.names import ArchiveRejected
from vitac.evaluator.submission.sources import NoSubmission, submission_digest


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    folder = tmp_path / "mine"
    (folder / "weights").mkdir(parents=True)
    (folder / "submission.yaml").write_text(MANIFEST)
    (folder / "policy.py").write_text("class Policy: ...\n")
    (folder / "weights" / "w.bin").write_bytes(b"\0" * 1000)
    return folder


def digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def names(archive: Path) -> list[str]:
    with zipfile.ZipFile(archive) as reader:
        return reader.namelist()


def test_packs_everything_under_one_top_folder_in_order(folder: Path, tmp_path: Path) -> None:
    assert pack(folder, tmp_path / "a.zip") == 3
    assert names(tmp_path / "a.zip") == ["Track_1/policy.py", "Track_1/submission.yaml", "Track_1/weights/w.bin"]


def test_same_files_give_the_same_bytes_whatever_their_times_and_modes(folder: Path, tmp_path: Path) -> None:
    pack(folder, tmp_path / "a.zip")
    for path in folder.rglob("*"):
        os.utime(path, (1_000_000_000, 1_000_000_000))
        path.chmod(0o700)
    pack(folder, tmp_path / "b.zip")
    assert digest(tmp_path / "a.zip") == digest(tmp_path / "b.zip")


def test_another_content_gives_other_bytes(folder: Path, tmp_path: Path) -> None:
    pack(folder, tmp_path / "a.zip")
    (folder / "policy.py").write_text("class Policy: pass\n")
    pack(folder, tmp_path / "b.zip")
    assert digest(tmp_path / "a.zip") != digest(tmp_path / "b.zip")


def test_leaves_out_what_running_the_policy_leaves_behind(folder: Path, tmp_path: Path) -> None:
    pack(folder, tmp_path / "a.zip")
    for name in ("__pycache__/policy.cpython-311.pyc", ".git/config", ".DS_Store", "old.pyc"):
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text("x")
    pack(folder, tmp_path / "b.zip")
    assert digest(tmp_path / "a.zip") == digest(tmp_path / "b.zip")


def test_refuses_a_link(folder: Path, tmp_path: Path) -> None:
    (folder / "link").symlink_to("/etc/passwd")
    with pytest.raises(ArchiveRejected, match="link"):
        pack(folder, tmp_path / "a.zip")


def test_a_folder_around_track_1_gives_the_same_archive(folder: Path, tmp_path: Path) -> None:
    pack(folder, tmp_path / "a.zip")
    (tmp_path / "outer").mkdir()
    folder.rename(tmp_path / "outer" / "Track_1")
    pack(tmp_path / "outer", tmp_path / "b.zip")
    assert digest(tmp_path / "a.zip") == digest(tmp_path / "b.zip")


def test_archive_and_folder_are_the_same_submission(folder: Path, tmp_path: Path) -> None:
    (folder / "__pycache__").mkdir()
    (folder / "__pycache__" / "policy.pyc").write_bytes(b"x")
    pack(folder, tmp_path / "a.zip")
    assert submission_digest(tmp_path / "a.zip") == submission_digest(folder)


def test_says_what_is_missing_in_a_folder_without_manifest(tmp_path: Path) -> None:
    with pytest.raises(NoSubmission, match=r"submission\.yaml"):
        pack(tmp_path, tmp_path / "a.zip")


def test_stores_what_does_not_shrink_and_compresses_the_rest(folder: Path, tmp_path: Path) -> None:
    (folder / "weights" / "random.bin").write_bytes(os.urandom(100_000))
    (folder / "weights" / "empty.bin").write_bytes(b"")
    pack(folder, tmp_path / "a.zip")
    with zipfile.ZipFile(tmp_path / "a.zip") as reader:
        methods = {info.filename.rpartition("/")[2]: info.compress_type for info in reader.infolist()}
        assert reader.testzip() is None
    assert methods["w.bin"] == zipfile.ZIP_DEFLATED
    assert methods["random.bin"] == methods["empty.bin"] == zipfile.ZIP_STORED
