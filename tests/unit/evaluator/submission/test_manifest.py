import io
import os
import stat
from pathlib import Path

import pytest
from submissions import FILES, MANIFEST, submission_folder, submission_zip, zip_bytes
from vitac.evaluator.agent.limits import Limits
from vitac.evaluator.submission.archive import ArchiveFault, ArchiveRejected, unpack
from vitac.evaluator.submission.manifest import (
    ManifestRejected,
    NoSubmission,
    find_submission,
    load_manifest,
    parse_manifest,
    stage,
    submission_digest,
)


def manifest_error(text: str | bytes) -> str:
    with pytest.raises(ManifestRejected) as caught:
        parse_manifest(text.encode() if isinstance(text, str) else text)
    return str(caught.value)


def test_reads_the_manifest(tmp_path: Path) -> None:
    manifest = load_manifest(submission_folder(tmp_path))
    assert (manifest.track, manifest.tasks, manifest.entry_point) == ("track_1", ("peg-insertion",), "policy:Policy")


def test_entry_point_has_a_default() -> None:
    assert parse_manifest(MANIFEST.replace("entry_point: policy:Policy\n", "").encode()).entry_point == "policy:Policy"


def test_missing_manifest_is_named(tmp_path: Path) -> None:
    with pytest.raises(ManifestRejected, match=r"submission\.yaml is missing"):
        load_manifest(tmp_path)


def test_unknown_key_names_the_nearest_valid_one() -> None:
    assert "did you mean 'entry_point'" in manifest_error(MANIFEST + "entrypoint: a:B\n")


@pytest.mark.parametrize("key", ["track", "tasks", "name"])
def test_missing_key_is_named(key: str) -> None:
    text = "".join(line + "\n" for line in MANIFEST.splitlines() if not line.startswith(f"{key}:"))
    assert f"Missing key '{key}'" in manifest_error(text)


@pytest.mark.parametrize("entry_point", ["policy", "policy.py:Policy()", "os:system('x')", "../evil:P", ":P", "a:b:c"])
def test_entry_point_must_be_module_and_class(entry_point: str) -> None:
    assert "entry_point" in manifest_error(MANIFEST.replace("policy:Policy", f'"{entry_point}"'))


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("track_1", "track_9", "track_1"),
        ("[peg-insertion]", "[peg-insertion, fly]", "peg-insertion"),
        ("[peg-insertion]", "[peg-insertion, peg-insertion]", "each once"),
        ("[peg-insertion]", "[]", "tasks"),
        ("test policy", '"\\e[31mred"', "printable"),
        ("test policy", '""', "name"),
        ("test policy", "x" * 81, "name"),
    ],
)
def test_wrong_values_are_told(old: str, new: str, told: str) -> None:
    assert told in manifest_error(MANIFEST.replace(old, new))


@pytest.mark.parametrize("data", ["[" * 20_000, b"\xff\xfe", "a: [b", "- a\n- b\n", "", "!!python/object:os.system x"])
def test_what_is_no_yaml_mapping_is_refused(data: str | bytes) -> None:
    assert manifest_error(data)


def test_too_large_manifest_is_refused(tmp_path: Path) -> None:
    submission_folder(tmp_path, {"submission.yaml": "# " + "x" * 70_000})
    with pytest.raises(ManifestRejected, match="larger than"):
        load_manifest(tmp_path)


def test_digest_of_zip_folder_and_unpacked_copy_agree(tmp_path: Path) -> None:
    files: dict[str, str | bytes] = {**FILES, "weights/b.bin": os.urandom(3000), "weights/a.bin": b""}
    folder = submission_folder(tmp_path / "folder", files)
    archive = tmp_path / "s.zip"
    archive.write_bytes(submission_zip(dict(reversed(list(files.items())))))
    digests = {
        submission_digest(folder),
        submission_digest(archive),
        submission_digest(unpack(archive, tmp_path / "a")),
        submission_digest(stage(folder, tmp_path / "b")),
    }
    assert len(digests) == 1


def test_digest_ignores_caches_but_nothing_else(tmp_path: Path) -> None:
    folder = submission_folder(tmp_path)
    before = submission_digest(folder)
    submission_folder(folder, {"__pycache__/x.pyc": "1", ".DS_Store": "2", "sub/old.pyc": "3", ".git/HEAD": "4"})
    assert submission_digest(folder) == before
    (folder / "policy.py").write_text("class Policy: pass\n")
    assert submission_digest(folder) != before


def test_digest_tells_apart_where_one_file_ends(tmp_path: Path) -> None:
    one = submission_folder(tmp_path / "1", {**FILES, "a": "xy", "b": ""})
    two = submission_folder(tmp_path / "2", {**FILES, "a": "x", "b": "y"})
    assert submission_digest(one) != submission_digest(two)


def test_finds_the_submission_in_its_top_folder(tmp_path: Path) -> None:
    inner = submission_folder(tmp_path / "Track_1")
    assert find_submission(tmp_path) == inner
    assert find_submission(inner) == inner
    with pytest.raises(NoSubmission, match=r"submission\.yaml"):
        find_submission(tmp_path.parent)


def test_staged_folder_is_readable_by_everyone(tmp_path: Path) -> None:
    folder = submission_folder(tmp_path / "in")
    (folder / "policy.py").chmod(0o600)
    staged = stage(folder, tmp_path / "out")
    assert stat.S_IMODE((staged / "policy.py").stat().st_mode) == 0o644
    assert stat.S_IMODE(staged.stat().st_mode) == 0o755


def test_staged_folder_goes_through_the_same_rules(tmp_path: Path) -> None:
    folder = submission_folder(tmp_path / "in")
    (folder / "link").symlink_to("/etc/passwd")
    with pytest.raises(ArchiveRejected) as caught:
        stage(folder, tmp_path / "out")
    assert caught.value.code is ArchiveFault.LINK


def test_folder_with_pipe_is_refused(tmp_path: Path) -> None:
    folder = submission_folder(tmp_path / "in")
    os.mkfifo(folder / "pipe")
    with pytest.raises(ArchiveRejected) as caught:
        submission_digest(folder)
    assert caught.value.code is ArchiveFault.SPECIAL_FILE


@pytest.mark.parametrize(
    ("limits", "fault"),
    [
        (Limits(archive_files=1), ArchiveFault.TOO_MANY_FILES),
        (Limits(archive_unpacked_bytes=50), ArchiveFault.UNPACKED_TOO_LARGE),
    ],
)
def test_limits_hold_for_folders(limits: Limits, fault: ArchiveFault, tmp_path: Path) -> None:
    folder = submission_folder(tmp_path / "in")
    with pytest.raises(ArchiveRejected) as caught:
        stage(folder, tmp_path / "out", limits)
    assert caught.value.code is fault
    assert not (tmp_path / "out" / "Track_1").exists()


def test_zip_with_other_top_folder_has_no_digest(tmp_path: Path) -> None:
    archive = tmp_path / "s.zip"
    archive.write_bytes(zip_bytes({"mine/policy.py": "x"}))
    with pytest.raises(ArchiveRejected):
        submission_digest(archive)
    with pytest.raises(ArchiveRejected):
        unpack(io.BytesIO(archive.read_bytes()), tmp_path / "out")
