"""Images here are a few files; tests/integration/sandbox/test_images.py plays whole ones."""

import gzip
import hashlib
import json
import stat
import tarfile
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import pytest
from images import Pack, as_is, config_bytes, docker_archive, entry, gzipped, oci_layout, tar_bytes, zstd
from vitac.evaluator.agent.limits import Limits
from vitac.evaluator.submission import image
from vitac.evaluator.submission.image import image_digest, load_program, unpack_image
from vitac.evaluator.submission.manifest import ManifestRejected
from vitac.evaluator.submission.names import ArchiveFault, ArchiveRejected
from vitac.evaluator.tracks import load_track

MANIFEST = b"track: track_1\ntasks: [peg-insertion]\nname: an image\n"
BASE = tar_bytes([entry("submission.yaml", MANIFEST), entry("policy", b"run", mode=0o755)])
COMMAND = ["/policy"]
Entries = Iterable[tuple[tarfile.TarInfo, bytes]]


def saved(
    folder: Path, layers: Sequence[bytes], make: Any = docker_archive, pack: Pack = as_is, **process: Any
) -> Path:
    path = folder / "policy.tar"
    path.write_bytes(make(layers, config_bytes(layers, COMMAND, **process), pack))
    return path


def unpacked(folder: Path, *layers: Entries) -> Path:
    """Return the files of an image with further layers over a base."""
    tar = saved(folder, [BASE, *map(tar_bytes, layers)])
    return unpack_image(tar, folder / "unpacked") / "root"


def rejected(folder: Path, tar: Path, limits: Limits | None = None) -> ArchiveRejected:
    """Return why an image is refused, after which nothing of it may be left, nor anything beside it."""
    before = sorted(folder.rglob("*"))
    with pytest.raises(ArchiveRejected) as caught:
        unpack_image(tar, folder / "unpacked", limits)
    (folder / "unpacked").rmdir()
    assert sorted(folder.rglob("*")) == before
    assert caught.value.message.endswith(".")
    return caught.value


@pytest.mark.parametrize("make", [docker_archive, oci_layout])
@pytest.mark.parametrize("pack", [as_is, gzipped, zstd])
def test_unpacks_what_tools_save_to_the_same_id(tmp_path: Path, make: Any, pack: Pack) -> None:
    long = "deep/" * 30 + "é" * 60
    layers = [BASE, tar_bytes([entry(long, b"far down"), entry("empty/", type=tarfile.DIRTYPE)])]
    tar = saved(tmp_path, layers, make, pack, Env=["A=1=2"], WorkingDir="")
    folder = unpack_image(tar, tmp_path / "unpacked")
    assert (folder / "root" / long).read_bytes() == b"far down"
    assert (folder / "root/empty").is_dir()
    program = load_program(folder)
    assert (program.arguments, program.variables, program.folder) == (("/policy",), {"A": "1=2"}, "/")
    assert image_digest(tar) == hashlib.sha256(config_bytes(layers, COMMAND, Env=["A=1=2"], WorkingDir="")).hexdigest()


def test_reads_names_as_gnu_tar_writes_them_too(tmp_path: Path) -> None:
    layer = tar_bytes(
        [entry("d/" * 90 + "file", b"1"), entry("link", type=tarfile.SYMTYPE, linkname="x" * 200)], tarfile.GNU_FORMAT
    )
    root = unpack_image(saved(tmp_path, [BASE, layer]), tmp_path / "unpacked") / "root"
    assert (root / ("d/" * 90) / "file").read_bytes() == b"1"
    assert str((root / "link").readlink()) == "x" * 200


def test_later_layers_replace_and_remove_what_is_below(tmp_path: Path) -> None:
    root = unpacked(
        tmp_path,
        [entry("a/gone", b"1"), entry("a/kept", b"1"), entry("b/old", b"1"), entry("c/old", b"1"), entry("both", b"1")],
        [
            entry("a/.wh.gone"),
            entry("b/new", b"2"),
            entry("b/.wh..wh..opq"),
            entry(".wh.c"),
            entry("c/new", b"2"),
            entry("both/inside", b"2"),
            entry(".wh..wh.plnk"),
        ],
    )
    files = {str(path.relative_to(root)): path.read_bytes() for path in root.rglob("*") if path.is_file()}
    expected = {"a/kept": b"1", "b/new": b"2", "c/new": b"2", "both/inside": b"2"}
    assert files == {"submission.yaml": MANIFEST, "policy": b"run", **expected}


def test_links_lead_where_they_lead_inside_the_image_and_never_out_of_it(tmp_path: Path) -> None:
    outside = tmp_path / "outside"
    outside.mkdir()
    root = unpacked(
        tmp_path,
        [
            entry("usr/lib/", type=tarfile.DIRTYPE),
            entry("lib", type=tarfile.SYMTYPE, linkname="usr/lib"),
            entry("host", type=tarfile.SYMTYPE, linkname=str(outside)),
            entry("up", type=tarfile.SYMTYPE, linkname="../../../../../etc"),
            entry("same", type=tarfile.LNKTYPE, linkname="/policy"),
        ],
        [entry("lib/new", b"1"), entry("host/file", b"2"), entry("up/passwd", b"3")],
    )
    assert (root / "usr/lib/new").read_bytes() == b"1"
    assert list(outside.iterdir()) == []
    assert (root / "etc/passwd").read_bytes() == b"3"
    assert (root / "same").samefile(root / "policy")


def test_files_lose_rights_and_owners_but_neither_their_times_nor_that_they_are_programs(tmp_path: Path) -> None:
    root = unpacked(
        tmp_path,
        [
            entry("su", b"1", mode=0o4755, mtime=1_700_000_000, uid=0),
            entry("secret", b"1", mode=0o600),
            entry("closed/", type=tarfile.DIRTYPE, mode=0o000),
            entry("dev/null", type=tarfile.CHRTYPE, devmajor=1, devminor=3),
            entry("tmp/left", b"1"),
        ],
    )
    modes = {name: stat.S_IMODE((root / name).stat().st_mode) for name in ("su", "secret", "closed", "dev", "tmp")}
    assert modes == {"su": 0o755, "secret": 0o644, "closed": 0o755, "dev": 0o755, "tmp": 0o755}
    assert (root / "su").stat().st_mtime == 1_700_000_000
    assert [*(root / "dev").iterdir(), *(root / "tmp").iterdir()] == []  # the sandbox has its own


def _bad(name: str, **attributes: Any) -> bytes:
    return tar_bytes([entry(name, **attributes)])


def _hard_link(target: str) -> bytes:
    return _bad("hard", type=tarfile.LNKTYPE, linkname=target)


@pytest.mark.parametrize(
    ("layer", "code", "part"),
    [
        (_bad("../out"), ArchiveFault.PARENT_PATH, "leads out of the image"),
        (_bad("/a/../../out"), ArchiveFault.PARENT_PATH, "leads out of the image"),
        (_bad(".wh."), ArchiveFault.PARENT_PATH, "removes the folder"),
        (_bad("/.wh.."), ArchiveFault.PARENT_PATH, "removes the folder"),
        (_bad("a/.wh..."), ArchiveFault.PARENT_PATH, "removes the folder"),
        (_bad("disk", type=tarfile.BLKTYPE, devmajor=8), ArchiveFault.SPECIAL_FILE, "'disk' is not a regular file"),
        (_bad("devices/null", type=tarfile.CHRTYPE), ArchiveFault.SPECIAL_FILE, "not a regular file"),
        (_bad("pipe", type=tarfile.FIFOTYPE), ArchiveFault.SPECIAL_FILE, "not a regular file"),
        (_hard_link("/etc/shadow"), ArchiveFault.LINK, "expected an earlier file"),
        (_hard_link("../../etc/shadow"), ArchiveFault.LINK, "expected an earlier file"),
        (_hard_link("/"), ArchiveFault.LINK, "expected an earlier file"),
        (_bad("soft", type=tarfile.SYMTYPE), ArchiveFault.LINK, "'soft' is a link"),
        (_bad("d/" * 101 + "x"), ArchiveFault.TOO_DEEP, "nest less"),
        (_bad("n" * 256), ArchiveFault.NAME_TOO_LONG, "rename the file"),
        (
            tar_bytes([entry("a", type=tarfile.SYMTYPE, linkname="/b/../a"), entry("a/x")]),
            ArchiveFault.LINK,
            "in a circle",
        ),
        (_bad("a", pax_headers={"comment": "x" * (2 << 20)}), ArchiveFault.DAMAGED, "expected at most 1048576"),
        (_bad("a", pax_headers={"GNU.sparse.realsize": "9"}), ArchiveFault.SPECIAL_FILE, "regular file"),
        (tar_bytes([entry("a", b"12345")])[:514], ArchiveFault.DAMAGED, "ends in the middle of a file"),
        (b"no tar" * 200, ArchiveFault.DAMAGED, "a header cannot be read"),
        (b"\x1f\x8b no gzip", ArchiveFault.DAMAGED, "cannot be unpacked"),
        (b"\x28\xb5\x2f\xfd no zstd", ArchiveFault.DAMAGED, "cannot be unpacked"),
    ],
)
def test_refuses_a_hostile_layer(tmp_path: Path, layer: bytes, code: ArchiveFault, part: str) -> None:
    rejection = rejected(tmp_path, saved(tmp_path, [BASE, layer]))
    assert rejection.code is code
    assert part in rejection.message


def test_refuses_too_many_files_and_a_bomb(tmp_path: Path) -> None:
    many = tar_bytes(entry(f"f{number}") for number in range(1000))
    tar = saved(tmp_path, [BASE, many])
    assert rejected(tmp_path, tar, Limits(image_files=1000)).code is ArchiveFault.TOO_MANY_FILES
    bomb = gzip.compress(tar_bytes([entry("zeros", bytes(80 << 20))]), 9)
    tar = saved(tmp_path, [BASE, bomb])
    assert tar.stat().st_size < 1 << 20
    assert rejected(tmp_path, tar, Limits(image_bytes=32 << 20)).code is ArchiveFault.UNPACKED_TOO_LARGE
    assert rejected(tmp_path, tar).code is ArchiveFault.COMPRESSED_TOO_MUCH
    header = tarfile.TarInfo("zeros")
    header.size = 8 << 30  # which it only says
    tar = saved(tmp_path, [BASE, header.tobuf(tarfile.GNU_FORMAT)])
    assert rejected(tmp_path, tar).code is ArchiveFault.UNPACKED_TOO_LARGE


@pytest.mark.parametrize(("limit", "part"), [(10_000, "expected at most 10000, which track_1 takes"), (1 << 20, None)])
def test_a_track_has_a_limit_of_its_own_below_or_above_that_of_the_service(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, limit: int, part: str | None
) -> None:
    own = load_track("track_1").model_copy(update={"image_bytes": limit})
    monkeypatch.setattr(image, "load_track", lambda name: own if name == "track_1" else load_track(name))
    tar = saved(tmp_path, [BASE, tar_bytes([entry("data", bytes(20_000))])])
    service = Limits(image_bytes=1 << 20 if part else 10_000)
    if part:
        assert part in rejected(tmp_path, tar, service).message
    else:
        assert (unpack_image(tar, tmp_path / "unpacked", service) / "root/data").stat().st_size == 20_000


@pytest.mark.parametrize("make", [docker_archive, oci_layout])
def test_refuses_a_layer_whose_digest_is_another(tmp_path: Path, make: Any) -> None:
    config = config_bytes([BASE], COMMAND)
    tar = tmp_path / "policy.tar"
    tar.write_bytes(make([tar_bytes([entry("submission.yaml", MANIFEST), entry("policy", b"bad")])], config, as_is))
    rejection = rejected(tmp_path, tar)
    assert rejection.code is ArchiveFault.DAMAGED
    assert "expected sha256:" in rejection.message


def test_refuses_a_blob_that_is_not_what_its_name_says(tmp_path: Path) -> None:
    whole = oci_layout([BASE], config_bytes([BASE], COMMAND), as_is)
    tar = tmp_path / "policy.tar"
    tar.write_bytes(whole.replace(b'"/policy"', b'"/pollcy"', 1))
    assert "expected sha256:" in rejected(tmp_path, tar).message


@pytest.mark.parametrize(
    ("files", "part"),
    [
        ({"other": b""}, "manifest.json or index.json"),
        ({"manifest.json": b"[]"}, "0 images, expected one"),
        ({"manifest.json": b"["}, "cannot be read"),
        ({"manifest.json": b"[" * 100_000}, "cannot be read"),
        ({"manifest.json": b'[{"Config": "../../etc/passwd", "Layers": []}]'}, "'../../etc/passwd' is missing"),
        ({"index.json": b'{"manifests": [{"digest": "sha256:../../x"}]}'}, "expected sha256 and 64 digits"),
        ({"index.json": b'{"manifests": []}'}, "0 images for linux"),
    ],
)
def test_refuses_a_tar_that_is_no_image(tmp_path: Path, files: dict[str, bytes], part: str) -> None:
    tar = tmp_path / "policy.tar"
    tar.write_bytes(tar_bytes(entry(name, content) for name, content in files.items()))
    assert part in rejected(tmp_path, tar).message


def test_says_what_to_do_with_an_image_that_is_packed_as_a_whole_or_for_another_machine(tmp_path: Path) -> None:
    tar = saved(tmp_path, [BASE])
    tar.write_bytes(gzip.compress(tar.read_bytes()))
    assert "`gunzip`" in rejected(tmp_path, tar).message
    config = json.loads(config_bytes([BASE], COMMAND)) | {"architecture": "riscv64"}
    tar.write_bytes(docker_archive([BASE], json.dumps(config).encode()))
    assert "--platform linux/" in rejected(tmp_path, tar).message
    assert "no command" in rejected(tmp_path, saved(tmp_path, [BASE], Cmd=None)).message


@pytest.mark.parametrize(
    ("entries", "part"),
    [
        ([entry(".wh.submission.yaml")], "COPY submission.yaml /"),
        ([entry("submission.yaml", type=tarfile.SYMTYPE, linkname="/etc/hostname")], "COPY submission.yaml /"),
        ([entry("submission.yaml", MANIFEST + b"entry_point: policy:Policy\n")], "whose command plays"),
    ],
)
def test_needs_a_submission_yaml_of_its_own(tmp_path: Path, entries: Entries, part: str) -> None:
    tar = saved(tmp_path, [BASE, tar_bytes(entries)])
    with pytest.raises(ManifestRejected, match=part):
        unpack_image(tar, tmp_path / "unpacked")
    assert not any((tmp_path / "unpacked").iterdir())
