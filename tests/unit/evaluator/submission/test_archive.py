import contextlib
import io
import os
import stat
import struct
import tempfile
import zipfile
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from submissions import FILES, entry, submission_folder, submission_zip, zip_bytes
from vitac.evaluator.agent.limits import Limits
from vitac.evaluator.submission.archive import ArchiveEntry, ArchiveFault, ArchiveRejected, unpack, write
from vitac.evaluator.submission.manifest import ManifestRejected, load_manifest
from vitac.evaluator.submission.names import NamedEntry, check_names
from vitac.evaluator.submission.sources import read_manifest_file, stage, submission_digest


def rejected(data: bytes, folder: Path, limits: Limits | None = None) -> ArchiveRejected:
    """Unpack what must be refused; also makes sure that nothing was left and nothing escaped."""
    destination = folder / "inside" / "unpacked"
    with pytest.raises(ArchiveRejected) as caught:
        unpack(io.BytesIO(data), destination, limits)
    assert not destination.exists() or list(destination.iterdir()) == []
    assert [path.name for path in folder.rglob("*") if path.is_file() or path.is_symlink()] == []
    assert caught.value.message
    return caught.value


def with_file(name: str | zipfile.ZipInfo, content: str | bytes = "x") -> bytes:
    files: dict[str | zipfile.ZipInfo, str | bytes] = {f"Track_1/{path}": text for path, text in FILES.items()}
    return zip_bytes({**files, name: content})


def patched(data: bytes, name: bytes, new_name: bytes) -> bytes:
    """Replace a name of the same length in local header and directory, as a tool that refuses it would not."""
    assert len(name) == len(new_name)
    assert data.count(name) >= 2
    return data.replace(name, new_name)


def test_unpacks_a_submission_readable_by_everyone(tmp_path: Path) -> None:
    folder = unpack(io.BytesIO(submission_zip({**FILES, "weights/a.bin": b"\0" * 10})), tmp_path / "out")
    assert folder == tmp_path / "out" / "Track_1"
    assert (folder / "policy.py").read_text() == FILES["policy.py"]
    assert stat.S_IMODE((folder / "weights").stat().st_mode) == 0o755
    assert stat.S_IMODE((folder / "weights" / "a.bin").stat().st_mode) == 0o644


def test_accepts_folder_entries_and_leaves_caches_out(tmp_path: Path) -> None:
    data = zip_bytes(
        {
            entry("Track_1/", stat.S_IFDIR | 0o755): "",
            "Track_1/policy.py": "x",
            entry("Track_1/empty/", stat.S_IFDIR | 0o755): "",
            "Track_1/__pycache__/policy.cpython-311.pyc": "y",
            "Track_1/.DS_Store": "z",
            "__MACOSX/Track_1/._policy.py": "z",
        }
    )
    folder = unpack(io.BytesIO(data), tmp_path / "out")
    assert sorted(path.name for path in folder.rglob("*")) == ["policy.py"]


@pytest.mark.parametrize(
    ("name", "fault"),
    [
        ("Track_1/../evil.py", ArchiveFault.PARENT_PATH),
        ("../evil.py", ArchiveFault.PARENT_PATH),
        ("Track_1/./a.py", ArchiveFault.PARENT_PATH),
        ("Track_1//a.py", ArchiveFault.PARENT_PATH),
        ("/etc/evil", ArchiveFault.ABSOLUTE_PATH),
        ("C:/evil", ArchiveFault.ABSOLUTE_PATH),
        ("Track_1/..\\evil.py", ArchiveFault.BAD_CHARACTERS),
        ("Track_1/a\nb.py", ArchiveFault.BAD_CHARACTERS),
        ("Track_1/a\x1b[31m.py", ArchiveFault.BAD_CHARACTERS),
        ("Track_1/a\u202eyp.exe", ArchiveFault.BAD_CHARACTERS),
        ("Track_1/" + "d/" * 16 + "a.py", ArchiveFault.TOO_DEEP),
        ("Track_1/" + "a" * 256, ArchiveFault.NAME_TOO_LONG),
        ("Track_1/" + "ä" * 128, ArchiveFault.NAME_TOO_LONG),
        ("Track_1/Policy.py", ArchiveFault.CASE_DUPLICATE),
        ("track_1/other.py", ArchiveFault.CASE_DUPLICATE),
        ("Track_2/policy.py", ArchiveFault.WRONG_TOP_FOLDER),
        ("policy.py", ArchiveFault.WRONG_TOP_FOLDER),
        ("Track_1/policy.py/inside", ArchiveFault.DUPLICATE),
    ],
)
def test_rejects_archive_with_bad_name(name: str, fault: ArchiveFault, tmp_path: Path) -> None:
    assert rejected(with_file(name), tmp_path).code is fault


def test_rejects_a_name_with_a_null_byte_that_readers_cut_off(tmp_path: Path) -> None:
    data = patched(with_file("Track_1/aaXbb.py"), b"Track_1/aaXbb.py", b"Track_1/aa\0bb.py")
    assert rejected(data, tmp_path).code is ArchiveFault.BAD_CHARACTERS


def test_rejects_archive_with_the_same_file_twice(tmp_path: Path) -> None:
    data = patched(with_file("Track_1/policx.py"), b"Track_1/policx.py", b"Track_1/policy.py")
    assert rejected(data, tmp_path).code is ArchiveFault.DUPLICATE


def test_rejects_archive_with_symlink(tmp_path: Path) -> None:
    data = with_file(entry("Track_1/link", stat.S_IFLNK | 0o777), "/etc/passwd")
    assert rejected(data, tmp_path).code is ArchiveFault.LINK


@pytest.mark.parametrize("kind", [stat.S_IFCHR, stat.S_IFBLK, stat.S_IFIFO, stat.S_IFSOCK])
def test_rejects_archive_with_device(kind: int, tmp_path: Path) -> None:
    assert rejected(with_file(entry("Track_1/device", kind | 0o666)), tmp_path).code is ArchiveFault.SPECIAL_FILE


def test_rejects_archive_with_ten_thousand_files(tmp_path: Path) -> None:
    data = submission_zip({f"f{number}": "" for number in range(10_000)})
    assert rejected(data, tmp_path).code is ArchiveFault.TOO_MANY_FILES


def test_rejects_huge_directory_before_reading_it(tmp_path: Path) -> None:
    """The end record may lie about the number; the directory's size counts."""
    limits = Limits(archive_files=2)
    data = bytearray(submission_zip({f"{'n' * 200}{number}": "" for number in range(40)}))
    end = data.rfind(b"PK\x05\x06")
    struct.pack_into("<HH", data, end + 8, 1, 1)
    assert rejected(bytes(data), tmp_path, limits).code is ArchiveFault.TOO_MANY_FILES


def with_zip64_end(data: bytes, *, entries: int, directory_bytes: int) -> bytes:
    """The archive with the end record of large ones before its own, as streaming programs write it."""
    end = data.rfind(b"PK\x05\x06")
    directory_start = struct.unpack_from("<L", data, end + 16)[0]
    record = struct.pack(
        "<4sQ2H2L4Q", b"PK\x06\x06", 44, 45, 45, 0, 0, entries, entries, directory_bytes, directory_start
    )
    locator = struct.pack("<4sLQL", b"PK\x06\x07", 0, end, 1)
    return data[:end] + record + locator + data[end : end + 8] + b"\xff" * 12 + data[end + 20 :]


def test_a_small_archive_with_the_end_record_of_large_ones_is_read(tmp_path: Path) -> None:
    data = submission_zip()
    end = data.rfind(b"PK\x05\x06")
    directory_bytes = struct.unpack_from("<L", data, end + 12)[0]
    folder = unpack(io.BytesIO(with_zip64_end(data, entries=2, directory_bytes=directory_bytes)), tmp_path / "out")
    assert (folder / "policy.py").read_text() == FILES["policy.py"]


@pytest.mark.parametrize(("entries", "directory_bytes"), [(5001, 100), (2, 2**40), (2**63, 2**63)])
def test_a_huge_directory_is_refused_in_the_end_record_of_large_archives_too(
    entries: int, directory_bytes: int, tmp_path: Path
) -> None:
    data = with_zip64_end(submission_zip(), entries=entries, directory_bytes=directory_bytes)
    assert rejected(data, tmp_path).code is ArchiveFault.TOO_MANY_FILES


def test_a_locator_without_its_end_record_is_damaged(tmp_path: Path) -> None:
    data = submission_zip()
    end = data.rfind(b"PK\x05\x06")
    locator = struct.pack("<4sLQL", b"PK\x06\x07", 0, 0, 1)
    assert rejected(data[:end] + locator + data[end:], tmp_path).code is ArchiveFault.DAMAGED


def test_rejects_bomb_by_ratio(tmp_path: Path) -> None:
    data = submission_zip({**FILES, "zeros": b"\0" * (40 * 1024 * 1024)})
    assert rejected(data, tmp_path).code is ArchiveFault.COMPRESSED_TOO_MUCH


def test_rejects_what_unpacks_to_too_much(tmp_path: Path) -> None:
    limits = Limits(archive_unpacked_bytes=1000)
    assert rejected(submission_zip({"a": b"a" * 1001}), tmp_path, limits).code is ArchiveFault.UNPACKED_TOO_LARGE


def test_rejects_bomb_that_lies_about_its_size(tmp_path: Path) -> None:
    """The directory announces 10 bytes, the data inflates to a million."""
    data = bytearray(submission_zip({"zeros": b"\0" * 1_000_000}))
    directory = data.find(b"PK\x01\x02")
    struct.pack_into("<L", data, directory + 24, 10)
    struct.pack_into("<L", data, 22, 10)
    assert rejected(bytes(data), tmp_path).code is ArchiveFault.DAMAGED


def test_folders_that_paths_imply_count_as_files(tmp_path: Path) -> None:
    """4,990 files in 15 folders each make 79,841 files and folders."""
    deep: dict[str, str] = {"/".join(f"{number}_{depth}" for depth in range(15)) + "/f": "" for number in range(4_990)}
    assert rejected(submission_zip(FILES | deep), tmp_path).code is ArchiveFault.TOO_MANY_FILES
    assert rejected(submission_zip(FILES | {"a/b/f": ""}), tmp_path, Limits(archive_files=5)).code
    unpack(io.BytesIO(submission_zip(FILES | {"a/b/f": ""})), tmp_path / "fits", Limits(archive_files=6))


def test_rejects_overlapping_entries(tmp_path: Path) -> None:
    """Many directory entries that point at the same data unpack to more than the archive could hold."""
    data = bytearray(submission_zip({f"f{number}": b"\0" * 1_000_000 for number in range(2)}))
    first = data.find(b"PK\x01\x02")
    second = data.find(b"PK\x01\x02", first + 4)
    struct.pack_into("<L", data, second + 42, 0)
    assert rejected(bytes(data), tmp_path).code is ArchiveFault.DAMAGED


def test_rejects_packed_size_over_limit(tmp_path: Path) -> None:
    assert rejected(submission_zip(), tmp_path, Limits(archive_packed_bytes=100)).code is ArchiveFault.TOO_LARGE


@pytest.mark.parametrize("data", [b"", b"PK", b"no zip at all", b"\x1f\x8b" + b"\0" * 100, b"\0" * 1000])
def test_rejects_what_is_no_zip(data: bytes, tmp_path: Path) -> None:
    assert rejected(data, tmp_path).code is ArchiveFault.NOT_A_ZIP


@pytest.mark.parametrize("kept", [10, 100, 0.5, 0.9, -1])
def test_rejects_truncated_archive(kept: float, tmp_path: Path) -> None:
    data = submission_zip()
    length = int(len(data) * kept) if isinstance(kept, float) else kept
    assert rejected(data[:length], tmp_path).code is ArchiveFault.DAMAGED


def test_rejects_corrupt_contents(tmp_path: Path) -> None:
    data = bytearray(submission_zip({"a.bin": bytes(range(256)) * 20}))
    data[60] ^= 0xFF
    assert rejected(bytes(data), tmp_path).code is ArchiveFault.DAMAGED


def test_rejects_encrypted_file(tmp_path: Path) -> None:
    data = bytearray(submission_zip())
    directory = data.find(b"PK\x01\x02")
    data[directory + 8] |= 1
    assert rejected(bytes(data), tmp_path).code is ArchiveFault.ENCRYPTED


@pytest.mark.parametrize("method", [zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
def test_rejects_other_compression_methods(method: int, tmp_path: Path) -> None:
    data = with_file(entry("Track_1/a", method=method), "x" * 100)
    assert rejected(data, tmp_path).code is ArchiveFault.COMPRESSION_METHOD


def test_rejects_empty_archive(tmp_path: Path) -> None:
    assert rejected(zip_bytes({}), tmp_path).code is ArchiveFault.WRONG_TOP_FOLDER


def test_refuses_to_unpack_over_something(tmp_path: Path) -> None:
    unpack(io.BytesIO(submission_zip()), tmp_path)
    with pytest.raises(FileExistsError):
        unpack(io.BytesIO(submission_zip()), tmp_path)


def file_of(content: bytes, path: str = "policy.py") -> ArchiveEntry:
    return ArchiveEntry(path=path, n_bytes=len(content), open=lambda: io.BytesIO(content))


@pytest.mark.parametrize("sizes", [(10,), (6, 4), (9, 1), (10, 0)])
def test_writes_as_many_bytes_as_are_allowed(sizes: tuple[int, ...], tmp_path: Path) -> None:
    files = [file_of(b"x" * size, f"{number}.bin") for number, size in enumerate(sizes)]
    folder = write(files, tmp_path / "out", "Track_1", Limits(archive_unpacked_bytes=10))
    assert tuple(path.stat().st_size for path in sorted(folder.iterdir())) == sizes


@pytest.mark.parametrize("sizes", [(11,), (6, 5), (10, 1)])
def test_rejects_one_byte_more_than_is_allowed(sizes: tuple[int, ...], tmp_path: Path) -> None:
    files = [file_of(b"x" * size, f"{number}.bin") for number, size in enumerate(sizes)]
    with pytest.raises(ArchiveRejected) as caught:
        write(files, tmp_path / "out", "Track_1", Limits(archive_unpacked_bytes=10))
    assert caught.value.code is ArchiveFault.UNPACKED_TOO_LARGE
    assert list((tmp_path / "out").iterdir()) == []


@pytest.mark.parametrize("link_to", [Path.symlink_to, Path.hardlink_to])
def test_never_writes_through_a_link_that_appears_while_unpacking(
    link_to: Callable[[Path, Path], None], tmp_path: Path
) -> None:
    outside = tmp_path / "outside"
    outside.write_bytes(b"ours")

    def files() -> Iterator[ArchiveEntry]:
        link_to(tmp_path / "out" / "Track_1" / "policy.py", outside)
        yield file_of(b"theirs")

    with pytest.raises(FileExistsError):
        write(files(), tmp_path / "out", "Track_1", Limits())
    assert outside.read_bytes() == b"ours"


@given(st.lists(st.text(max_size=12), max_size=6))
def test_names_that_pass_stay_below_their_folder(names: list[str]) -> None:
    try:
        check_names((NamedEntry(path=name, is_folder=False) for name in names), Limits())
    except ArchiveRejected:
        return
    for name in names:
        parts = Path("/base", name).parts
        assert parts[1] == "base"
        assert ".." not in parts
        assert name.isprintable() or " " in name or not name.isascii()
    assert len({name.casefold() for name in names}) == len(names)


@given(st.binary(max_size=400), st.integers(0, 400))
@example(b"\0\0", 369)  # a name that begins with NUL
def test_damaged_archives_never_raise_anything_else(noise: bytes, position: int) -> None:
    data = submission_zip()
    position = min(position, len(data))
    damaged = data[:position] + noise + data[position + len(noise) :]
    with tempfile.TemporaryDirectory() as folder, contextlib.suppress(ArchiveRejected, ManifestRejected):
        unpack(io.BytesIO(damaged), Path(folder, "out"))


@pytest.mark.parametrize(
    ("paths", "mend"),
    [
        (["mine/submission.yaml", "mine/policy.py"], "rename that folder"),
        (["mine/Track_1/submission.yaml", "mine/Track_1/policy.py"], "pack Track_1 itself"),
    ],
)
def test_usual_mistakes_about_the_top_folder_are_refused_with_their_mend(
    tmp_path: Path, paths: list[str], mend: str
) -> None:
    caught = rejected(zip_bytes(dict.fromkeys(paths, b"x")), tmp_path)
    assert caught.code is ArchiveFault.WRONG_TOP_FOLDER
    assert mend in caught.message


STRAY = [
    *(".DS_Store", "._policy.py", "Thumbs.db", "desktop.ini", ".idea/workspace.xml", ".vscode/settings.json"),
    *(".ipynb_checkpoints/a-checkpoint.ipynb", "sub/.ipynb_checkpoints/b.py", "sub/._c.py", "__pycache__/policy.pyc"),
]


def test_what_desktops_and_editors_leave_is_no_part_of_a_submission(tmp_path: Path) -> None:
    data = submission_zip(FILES | dict.fromkeys(STRAY, "x"))
    with zipfile.ZipFile(buffer := io.BytesIO(data), "a") as archive:
        for name in ["README.md", "readme.txt", "LICENSE", "__MACOSX/._Track_1", *STRAY]:
            archive.writestr(name, "x")
    folder = unpack(buffer, tmp_path / "out")
    assert {path.name for path in folder.rglob("*")} == {*FILES}
    own = submission_folder(tmp_path / "own", {**FILES, **dict.fromkeys(STRAY, "x")})
    assert submission_digest(own) == submission_digest(folder)


def test_a_zip_of_the_folders_content_is_that_of_the_track_that_its_manifest_names(tmp_path: Path) -> None:
    data = submission_zip(FILES | {"README.md": "x", "weights/a.bin": "y", ".DS_Store": "z"}, top="")
    folder = unpack(io.BytesIO(data), tmp_path / "out")
    assert folder.name == "Track_1"
    assert {path.name for path in folder.rglob("*.*")} == {*FILES, "README.md", "a.bin"}
    (tmp_path / "mine.zip").write_bytes(data)
    assert read_manifest_file(tmp_path / "mine.zip").track == "track_1"
    assert submission_digest(tmp_path / "mine.zip") == submission_digest(folder)


@pytest.mark.parametrize("manifest", ["x", "track: track_9\ntasks: [a]\nname: b\n", "track: [" * 9000, "a" * 17000])
def test_a_zip_of_the_folders_content_without_a_track_is_refused(manifest: str, tmp_path: Path) -> None:
    with pytest.raises(ManifestRejected):
        unpack(io.BytesIO(zip_bytes({"submission.yaml": manifest})), tmp_path / "out")


def test_files_of_a_submission_are_found_in_capitals(tmp_path: Path) -> None:
    spelled = {"Submission.YAML": FILES["submission.yaml"], "SENSOR.yaml": "{}", "gel.STL": "x", "Policy.py": "y"}
    folder = unpack(io.BytesIO(submission_zip(spelled)), tmp_path / "out")
    assert {path.name for path in folder.iterdir()} == {"submission.yaml", "sensor.yaml", "gel.stl", "Policy.py"}
    own = submission_folder(tmp_path / "own", spelled)
    assert load_manifest(own).track == "track_1"
    assert submission_digest(own) == submission_digest(folder)
    assert {path.name for path in stage(own, tmp_path / "staged").iterdir()} == {path.name for path in folder.iterdir()}


def test_one_file_in_two_spellings_is_refused(tmp_path: Path) -> None:
    assert rejected(with_file("Track_1/Submission.YAML"), tmp_path).code is ArchiveFault.CASE_DUPLICATE


def renamed(name: bytes) -> bytes:
    """A zip with a file of this name, without the flag that it is in UTF-8."""
    plain = b"Track_1/" + b"a" * len(name)
    return with_file(plain.decode()).replace(plain, b"Track_1/" + name)


def test_names_in_utf_8_without_its_flag_are_read(tmp_path: Path) -> None:
    folder = unpack(io.BytesIO(renamed("poids_é.npz".encode())), tmp_path / "out")
    assert (folder / "poids_é.npz").exists()


@pytest.mark.parametrize(("name", "mend"), [("权重.npz".encode("gbk"), "such as GBK"), (b"a\\b.py", "backslashes")])
def test_names_of_other_programs_are_refused_with_what_helps(name: bytes, mend: str, tmp_path: Path) -> None:
    caught = rejected(renamed(name), tmp_path)
    assert caught.code is ArchiveFault.BAD_CHARACTERS
    assert mend in caught.message
    assert "python -m zipfile" in caught.message


def test_a_top_folder_with_any_name_is_shown_harmlessly(tmp_path: Path) -> None:
    caught = rejected(zip_bytes({f"{'x' * 200}/{'y' * 10}": b"x"}), tmp_path)
    assert caught.message.count("x") < 100


@pytest.mark.parametrize("said", [0, 4, 6, 1000])
def test_a_file_of_another_size_than_it_says_is_damaged_and_leaves_nothing(said: int, tmp_path: Path) -> None:
    with pytest.raises(ArchiveRejected) as refused:
        write([file_of(b"first", "a.py"), replace(file_of(b"12345", "b.py"), n_bytes=said)], tmp_path, "Top", Limits())
    assert refused.value.code is ArchiveFault.DAMAGED
    assert refused.value.message == (
        f"The archive is damaged: 'b.py' has 5 bytes, expected {said}. Pack and upload it again."
    )
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("mask", [0o022, 0o027, 0o077])
def test_files_and_folders_are_readable_by_everyone_whatever_the_umask(mask: int, tmp_path: Path) -> None:
    """The policy runs as a user of its own, who must be able to read them."""
    before = os.umask(mask)
    try:
        folder = write([file_of(b"1", "a/b/c.py"), file_of(b"2", "a/d.py")], tmp_path, "Top", Limits())
    finally:
        os.umask(before)
    made = [folder, *folder.rglob("*")]
    assert {oct(path.stat().st_mode & 0o777) for path in made if path.is_dir()} == {"0o755"}
    assert {oct(path.stat().st_mode & 0o777) for path in made if path.is_file()} == {"0o644"}
    assert len(made) == 5
