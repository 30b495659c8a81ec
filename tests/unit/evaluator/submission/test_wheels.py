"""A wheel here has a module, METADATA and an empty RECORD; pip's own makes are played in tests/integration/sandbox."""

import hashlib
import json
import shutil
import stat
import threading
from collections.abc import Iterator, Mapping
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest
from submissions import FILES, MANIFEST, entry, submission_folder, submission_zip, wheel_bytes, zip_bytes
from vitac.evaluator.agent.isolation.packages import policy_versions
from vitac.evaluator.agent.limits import Limits
from vitac.evaluator.submission.names import ArchiveFault, ArchiveRejected
from vitac.evaluator.submission.sources import stage

WHEEL = "wheels/feelings-1.0-py3-none-any.whl"
PIN = "feelings==1.0"


def staged(folder: Path, files: Mapping[str, str | bytes], limits: Limits | None = None) -> Path:
    """Stage a submission with more files, as a folder and as a zip, which must give the same."""
    files = {**FILES, **files}
    folder.mkdir(exist_ok=True)
    archive = folder / "submission.zip"
    archive.write_bytes(submission_zip(files))
    of_zip = stage(archive, folder / "of_zip", limits)
    of_folder = stage(submission_folder(folder / "folder", files), folder / "of_folder", limits)
    assert contents(of_zip) == contents(of_folder)
    return of_folder


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def rejected(folder: Path, files: Mapping[str, str | bytes], limits: Limits | None = None) -> ArchiveRejected:
    submission = submission_folder(folder / "folder", {**FILES, **files})
    with pytest.raises(ArchiveRejected) as caught:
        stage(submission, folder / "staged", limits)
    return caught.value


def hash_of(wheel: bytes) -> str:
    return f"--hash=sha256:{hashlib.sha256(wheel).hexdigest()}"


@pytest.fixture
def house(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    folder = tmp_path / "house"
    folder.mkdir()
    (folder / "feelings-0.9-py3-none-any.whl").write_bytes(wheel_bytes(version="0.9"))
    (folder / "feelings-1.0-cp27-none-win32.whl").write_bytes(b"of another machine")
    (folder / "feelings-1.0-py3-none-any.whl").write_bytes(wheel_bytes())
    (folder / "notes.whl").write_text("named otherwise")
    monkeypatch.setenv("VITAC_WHEEL_HOUSE", str(folder))
    return folder


def test_the_files_of_wheels_lie_in_one_folder_that_is_listed(tmp_path: Path) -> None:
    record = {"feelings-1.0.dist-info/RECORD": b"\xff"}  # nothing reads it
    files = {
        WHEEL: wheel_bytes(files=record, fields="Requires-Dist: numpy>=1\n"),
        "wheels/Sense_Less-2.1-py3-none-any.whl": wheel_bytes("Sense_Less", "2.1"),
    }
    folder = staged(tmp_path, files)
    assert (folder / "site-packages/feelings/__init__.py").read_text() == "version = '1.0'\n"
    assert not list(folder.rglob("*.whl"))
    versions = policy_versions(folder, ())
    assert (versions["feelings"], versions["sense-less"]) == ("1.0", "2.1")
    assert "numpy" in versions


def test_an_own_version_is_listed_in_place_of_the_shown_one(tmp_path: Path) -> None:
    folder = staged(tmp_path, {"wheels/numpy-99.0-py3-none-any.whl": wheel_bytes("numpy", "99.0")})
    assert policy_versions(folder, ())["numpy"] == "99.0"


def test_what_acts_beyond_a_folder_of_packages_is_left_out(tmp_path: Path) -> None:
    data = "feelings-1.0.data"
    files = {
        "evil.pth": "import os",
        f"{data}/purelib/evil.pth": "import os",
        f"{data}/purelib/feelings/more.py": "",
        f"{data}/scripts/evil": "#!python",
        f"{data}/data/etc/evil.py": "",
    }
    folder = staged(tmp_path, {WHEEL: wheel_bytes(files=files)})
    unpacked = contents(folder / "site-packages")
    assert "feelings/more.py" in unpacked
    assert not [path for path in contents(folder) if "evil" in path]


def test_a_folder_of_that_name_without_wheels_is_the_policys_own(tmp_path: Path) -> None:
    folder = staged(tmp_path, {"wheels/__init__.py": "x = 1"})
    assert contents(folder).keys() == {*FILES, "wheels/__init__.py"}


@pytest.mark.parametrize(
    ("files", "sentence"),
    [
        ({"wheels/feelings-1.0.tar.gz": b"x"}, "source distributions are not built"),
        ({WHEEL: wheel_bytes(), "wheels/notes.txt": b"x"}, "holds 'notes.txt', expected wheels only"),
        ({"wheels/feelings-1.0-cp27-cp27m-win32.whl": wheel_bytes()}, "another Python or platform"),
        ({WHEEL: wheel_bytes(fields="Requires-Python: <3\n")}, "needs Python <3"),
        ({"wheels/feelings.whl": wheel_bytes()}, "not named as wheels are"),
        ({WHEEL: wheel_bytes(version="1.1")}, "holds feelings 1.1"),
        ({WHEEL: zip_bytes({"feelings.py": ""})}, "is no wheel"),
        ({WHEEL: wheel_bytes(files={"other-2.dist-info/METADATA": "Name: other"})}, "expected one folder .dist-info"),
        ({WHEEL: wheel_bytes(fields="Requires-Dist: a b c\n")}, "cannot be read"),
        ({WHEEL: wheel_bytes(fields=f"Requires-Dist: numpy; {'(' * 9999}\n")}, "cannot be read"),
        ({WHEEL: wheel_bytes(fields=f"Requires-Dist: numpy=={'9' * 9999}\n")}, "cannot be read"),
        ({WHEEL: wheel_bytes(fields=f"Requires-Python: <{'9' * 9999}\n")}, "cannot be read"),
        ({WHEEL: wheel_bytes(fields="Requires-Dist: numpy\n" * 1001)}, "more than 1000 packages"),
        ({WHEEL: wheel_bytes(files={"feelings-1.0.dist-info/METADATA": ""})}, "cannot be read"),
        ({WHEEL: wheel_bytes(fields="Name: other\n")}, "cannot be read"),
        (
            {WHEEL: wheel_bytes(fields=f"Requires-Dist: feelings[{','.join(f'x{n}' for n in range(101))}]\n")},
            "more than 100 extras",
        ),
        ({"requirements.txt": f"numpy=={'9' * 9999} --hash=sha256:{'0' * 64}"}, "cannot be read"),
        ({"requirements.txt": f"numpy==1; {'(' * 9999} --hash=sha256:{'0' * 64}"}, "cannot be read"),
        ({WHEEL: wheel_bytes(fields="Requires-Dist: nowhere>2\n")}, "needs nowhere>2, which is not here"),
        ({WHEEL: wheel_bytes(fields="Requires-Dist: numpy<1\n")}, r"needs numpy<1, 2\.\S+ is here"),
        (
            {WHEEL: wheel_bytes(), "wheels/feelings-1.0-py2.py3-none-any.whl": wheel_bytes()},
            "are the same package; leave one",
        ),
        ({WHEEL: wheel_bytes(), "site-packages/x.py": ""}, "is where wheels are unpacked"),
        ({WHEEL: wheel_bytes(), "requirements.txt": f"{PIN}\n"}, "expected --hash=sha256"),
        ({WHEEL: wheel_bytes(), "requirements.txt": f"{PIN} --hash=md5:{'0' * 32}\n"}, "expected --hash=sha256"),
        ({WHEEL: wheel_bytes(), "requirements.txt": f"{PIN} --hash=sha256:{'0' * 64}"}, "not have for feelings"),
        ({WHEEL: wheel_bytes(), "requirements.txt": f"feelings==2.0 {hash_of(wheel_bytes())}"}, "is 1.0, but"),
        ({"requirements.txt": f"feelings>=1 {hash_of(b'')}"}, "expected one version"),
        ({"requirements.txt": f"feelings @ file:///etc/passwd {hash_of(b'')}"}, "expected one version"),
        ({"Requirements.TXT": "-r /etc/passwd"}, "and no other options"),
        ({"requirements.txt": f"{PIN} {hash_of(b'')}"}, "there is no wheel house here"),
    ],
)  # fmt: skip
def test_what_cannot_be_used_is_refused_in_one_sentence(
    files: Mapping[str, str | bytes], sentence: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("VITAC_WHEEL_HOUSE", raising=False)
    rejection = rejected(tmp_path, files)
    assert rejection.code is ArchiveFault.WHEEL
    with pytest.raises(ArchiveRejected, match=sentence):
        raise rejection


@pytest.mark.parametrize(
    ("content", "fault"),
    [
        (wheel_bytes(files={"../evil.py": ""}), ArchiveFault.PARENT_PATH),
        (wheel_bytes(files={"feelings-1.0.data/purelib/../../../evil.py": ""}), ArchiveFault.PARENT_PATH),
        (wheel_bytes(files={"feelings-1.0.data/purelib": ""}), ArchiveFault.PARENT_PATH),
        (wheel_bytes(files={"/etc/evil.py": ""}), ArchiveFault.ABSOLUTE_PATH),
        (wheel_bytes(files={entry("feelings/link.py", stat.S_IFLNK | 0o777): "/etc/passwd"}), ArchiveFault.LINK),
        (wheel_bytes(files={entry("feelings/pipe", stat.S_IFIFO | 0o644): ""}), ArchiveFault.SPECIAL_FILE),
        (wheel_bytes(files={"d/" * 16 + "a.py": ""}), ArchiveFault.TOO_DEEP),
        (wheel_bytes(files={"feelings-1.0.data/platlib/feelings/__init__.py": ""}), ArchiveFault.DUPLICATE),
        (wheel_bytes(files={f"feelings/{number}.py": "" for number in range(60)}), ArchiveFault.TOO_MANY_FILES),
        (wheel_bytes(files={"feelings/weights.bin": bytes(20_000)}), ArchiveFault.UNPACKED_TOO_LARGE),
        (wheel_bytes()[:-30], ArchiveFault.DAMAGED),
        (b"no zip", ArchiveFault.NOT_A_ZIP),
    ],
)
def test_wheels_follow_the_rules_of_archives(content: bytes, fault: ArchiveFault, tmp_path: Path) -> None:
    limits = Limits(archive_files=60, archive_unpacked_bytes=20_000)
    assert rejected(tmp_path, {WHEEL: content}, limits).code is fault
    assert not list(tmp_path.rglob("evil*"))


@pytest.mark.parametrize(
    ("limits", "fault"),
    [
        (Limits(archive_unpacked_bytes=30_000), ArchiveFault.UNPACKED_TOO_LARGE),
        (Limits(archive_files=50), ArchiveFault.TOO_MANY_FILES),
    ],
)
def test_wheels_and_own_files_together_are_limited(limits: Limits, fault: ArchiveFault, tmp_path: Path) -> None:
    own = {f"own/{number}.bin": bytes(600) for number in range(30)}
    more = {f"feelings/{number}.bin": bytes(600) for number in range(30)}
    assert rejected(tmp_path, {**own, WHEEL: wheel_bytes(files=more)}, limits).code is fault


def test_requirements_come_from_the_wheel_house_by_their_hash(house: Path, tmp_path: Path) -> None:
    digest = hash_of((house / "feelings-1.0-py3-none-any.whl").read_bytes())
    text = f"""
# of `uv pip compile --generate-hashes`
Feelings==1.0 ; python_version >= '3' \\
    --hash=sha256:{"0" * 64} \\
    {digest}
    # via a policy
elsewhere==1.0 ; sys_platform == 'win32' --hash=sha256:{"0" * 64}
"""
    folder = staged(tmp_path, {"requirements.txt": text})
    assert policy_versions(folder, ())["feelings"] == "1.0"


@pytest.mark.parametrize(
    ("line", "sentence"),
    [
        (f"{PIN} --hash=sha256:{'0' * 64}", "feelings-1.0-py3-none-any.whl has the hash"),
        (f"feelings==1.1 --hash=sha256:{'0' * 64}", "of which the wheel house has no wheel for Python"),
        (f"elsewhere==1.0 --hash=sha256:{'0' * 64}", "of which the wheel house has no wheel for Python"),
    ],
)
@pytest.mark.usefixtures("house")
def test_the_wheel_house_gives_only_what_is_meant(line: str, sentence: str, tmp_path: Path) -> None:
    with pytest.raises(ArchiveRejected, match=sentence):
        raise rejected(tmp_path, {"requirements.txt": line})


@pytest.fixture
def registry(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder of which each inner folder is a package of a registry: its list, and its files."""
    folder = tmp_path / "registry"
    handler = partial(SimpleHTTPRequestHandler, directory=str(folder))
    (folder / "feelings").mkdir(parents=True)
    monkeypatch.setattr(SimpleHTTPRequestHandler, "log_message", lambda *_: None)
    monkeypatch.setenv("VITAC_CACHE_DIR", str(tmp_path / "cache"))
    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        address = f"http://127.0.0.1:{server.server_port}"
        monkeypatch.setenv("VITAC_WHEEL_REGISTRIES", f"{address}/unknown/, {address}")
        yield folder / "feelings"
        server.shutdown()
        thread.join()


def publish(registry: Path, wheel: bytes, name: str = "feelings-1.0-py3-none-any.whl", digest: str = "") -> str:
    """Put a wheel into the registry; return the line of requirements.txt that means it."""
    digest = digest or hashlib.sha256(wheel).hexdigest()
    (registry / "1.whl").write_bytes(wheel)
    others = [{"filename": "feelings-1.0.tar.gz", "url": "x", "hashes": {"sha256": digest}}, {"filename": 3}]
    files = [*others, {"filename": name, "url": "1.whl", "hashes": {"sha256": digest}}]
    (registry / "index.html").write_text(json.dumps({"meta": {"api-version": "1.0"}, "files": files}))
    return f"{PIN} --hash=sha256:{digest}"


def test_a_registry_is_asked_once_for_a_wheel_by_its_hash(registry: Path, tmp_path: Path) -> None:
    line = publish(registry, wheel_bytes())
    folder = staged(tmp_path / "one", {"requirements.txt": line})
    assert policy_versions(folder, ())["feelings"] == "1.0"
    shutil.rmtree(registry)
    assert contents(staged(tmp_path / "two", {"requirements.txt": line})) == contents(folder)


@pytest.mark.parametrize(
    ("name", "digest", "sentence"),
    [
        ("feelings-1.1-py3-none-any.whl", "", "of which no registry has a wheel for Python"),
        ("feelings-1.0-cp27-none-win32.whl", "", "of which no registry has a wheel for Python"),
        ("../../feelings-1.0-py3-none-any.whl", "", "of which no registry has a wheel for Python"),
        ("feelings-1.0-py3-none-any.whl", "0" * 64, "the registry said 0000"),
    ],
)
def test_a_registry_gives_only_what_is_meant(
    registry: Path, name: str, digest: str, sentence: str, tmp_path: Path
) -> None:
    line = publish(registry, wheel_bytes(), name, digest)
    with pytest.raises(ArchiveRejected, match=sentence):
        raise rejected(tmp_path, {"requirements.txt": line})
    assert not list((tmp_path / "cache").rglob("*.whl"))
    assert not list((tmp_path / "cache").rglob("part-*"))


def test_a_registry_that_does_not_answer_or_sends_too_much_is_named(registry: Path, tmp_path: Path) -> None:
    line = publish(registry, wheel_bytes(files={"feelings/big.bin": bytes(9000)}))
    for number, (limits, sentence) in enumerate(
        [(Limits(archive_packed_bytes=100), "larger than 100 bytes"), (None, "could not be asked for feelings")]
    ):
        with pytest.raises(ArchiveRejected, match=sentence):
            raise rejected(tmp_path / str(number), {"requirements.txt": line}, limits)
        (registry / "index.html").write_text("[1]")


def test_the_wheels_used_longest_ago_make_room(registry: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("vitac.evaluator.submission.wheels._KEPT_BYTES", 0)
    staged(tmp_path / "one", {"requirements.txt": publish(registry, wheel_bytes())})
    staged(tmp_path / "two", {"requirements.txt": publish(registry, wheel_bytes(files={"feelings/more.py": b""}))})
    assert len(list((tmp_path / "cache").rglob("*.whl"))) == 1


@pytest.mark.usefixtures("house")
def test_a_shown_package_needs_no_wheel(tmp_path: Path) -> None:
    version = policy_versions(tmp_path, ())["numpy"]
    folder = staged(tmp_path, {"requirements.txt": f"numpy=={version} --hash=sha256:{'0' * 64}"})
    assert not (folder / "site-packages/numpy").exists()


def test_extras_are_looked_at_where_they_are_asked_for(tmp_path: Path) -> None:
    fields = "Provides-Extra: gpu\nRequires-Dist: nowhere; extra == 'gpu'\n"
    staged(tmp_path, {WHEEL: wheel_bytes(fields=fields)})
    other = wheel_bytes("wishes", fields="Requires-Dist: feelings[gpu]\n")
    files = {WHEEL: wheel_bytes(fields=fields), "wheels/wishes-1.0-py3-none-any.whl": other}
    with pytest.raises(ArchiveRejected, match="needs nowhere, which is not here"):
        raise rejected(tmp_path / "other", files)


def test_requirements_of_a_policy_server_are_its_own(tmp_path: Path) -> None:
    manifest = MANIFEST.replace("entry_point: policy:Policy", "remote: {protocol: openpi}")
    folder = staged(tmp_path, {"submission.yaml": manifest, "requirements.txt": "jax"})
    assert (folder / "requirements.txt").read_text() == "jax"
