import contextlib
import io
import os
import stat
import time
import tracemalloc
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import pytest
import yaml
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from submissions import FILES, MANIFEST, submission_folder, submission_zip, zip_bytes
from vitac.evaluator.agent.limits import Limits
from vitac.evaluator.submission.archive import ArchiveFault, ArchiveRejected, unpack
from vitac.evaluator.submission.manifest import ManifestRejected, load_manifest, load_unpacked_manifest, parse_manifest
from vitac.evaluator.submission.sources import (
    NoSubmission,
    find_submission,
    read_manifest_file,
    stage,
    submission_digest,
)
from vitac.evaluator.tracks import registry


def manifest_error(text: str | bytes) -> str:
    with pytest.raises(ManifestRejected) as caught:
        parse_manifest(text.encode() if isinstance(text, str) else text)
    return str(caught.value)


def test_reads_the_manifest(tmp_path: Path) -> None:
    manifest = load_manifest(submission_folder(tmp_path))
    assert (manifest.track, manifest.tasks, manifest.entry_point) == ("track_1", ("peg-insertion",), "policy:Policy")


def test_entry_point_has_a_default() -> None:
    assert parse_manifest(MANIFEST.replace("entry_point: policy:Policy\n", "").encode()).entry_point == "policy:Policy"


def test_observation_keys_are_those_named_and_all_where_none_are() -> None:
    assert parse_manifest(MANIFEST.encode()).observation_keys is None
    assert parse_manifest(f"{MANIFEST}observation_keys: []\n".encode()).observation_keys == ()
    named = parse_manifest(f"{MANIFEST}observation_keys: [marker_flow]\n".encode())
    assert named.observation_keys == ("marker_flow",)


@pytest.mark.parametrize("key", ["gt_offset", "rgb_picture", "", "marker_flow, marker_flow", "a" * 80])
def test_unknown_privileged_and_repeated_observation_keys_are_refused_with_the_valid_ones(key: str) -> None:
    error = manifest_error(f"{MANIFEST}observation_keys: [{key or repr('')}]\n")
    assert "observation_keys" in error
    if key:
        assert "expected each once, out of relative_motion, marker_flow" in error


def test_too_many_observation_keys_are_refused() -> None:
    assert "observation_keys" in manifest_error(f"{MANIFEST}observation_keys: [{'marker_flow, ' * 65}]\n")


def test_one_submission_can_play_all_tasks_of_the_track_that_has_most() -> None:
    track = registry.load_track("maniskill")
    modes = {name: task.definition.control_mode for name, task in track.tasks.items()}
    content = {"track": track.name, "name": "all of them", "tasks": list(modes), "control_modes": modes}
    manifest = parse_manifest(yaml.safe_dump(content).encode())
    assert (manifest.tasks, manifest.control_modes) == (tuple(track.tasks), modes)


def test_too_many_tasks_and_control_modes_are_refused() -> None:
    many = ", ".join(f"task-{number}" for number in range(129))
    assert "tasks" in manifest_error(MANIFEST.replace("[peg-insertion]", f"[{many}]"))
    modes = ", ".join(f"task-{number}: x" for number in range(129))
    assert "control_modes" in manifest_error(f"{MANIFEST}control_modes: {{{modes}}}\n")


def test_missing_manifest_is_named(tmp_path: Path) -> None:
    with pytest.raises(ManifestRejected, match=r"submission\.yaml is missing"):
        load_manifest(tmp_path)


def test_a_folder_in_place_of_the_manifest_is_refused(tmp_path: Path) -> None:
    archive = io.BytesIO(zip_bytes({"Track_1/submission.yaml/policy.py": "x"}))
    with pytest.raises(ManifestRejected, match=r"submission\.yaml is a folder, expected a file"):
        load_manifest(unpack(archive, tmp_path / "out"))


def test_a_file_in_place_of_the_folder_is_refused(tmp_path: Path) -> None:
    (tmp_path / "Track_1").touch()
    with pytest.raises(ManifestRejected, match=r"Track_1 is a file, expected a folder"):
        load_manifest(tmp_path / "Track_1")


def test_an_entry_point_with_a_dot_is_told_the_colon() -> None:
    told = manifest_error(MANIFEST.replace("policy:Policy", "policy.Policy"))
    assert "did you mean 'policy:Policy'?" in told
    assert "^" not in told


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


ALIASES_UNDER_PAIRS = "a: &a !!pairs [x: y]\n" + "".join(
    f"{new}: &{new} !!pairs [x: *{old}, x: *{old}, x: *{old}]\n" for old, new in pairwise("abcdefghijk")
)
"""A few hundred bytes whose text form would have 3 ** 10 parts."""


@pytest.mark.parametrize(
    "text",
    [
        ALIASES_UNDER_PAIRS,
        "? [a]\n: b\n",
        "? {a: b}\n: c\n",
        "name: " + "1" * 5_000,
        "name: 0x" + "f" * 8_000,
        "name: 2001-99-99",
        "name: 0b_",
        "name: !!int a",
        "name: !!bool a",
        "name: !!timestamp a",
        "name: !!float abc",
        "<<: [[a]]",
        "=: 1",
        '"\\ud800": 1',
        'name: "\\0"',
        'track: "track_1\\0"',
    ],
)
def test_values_that_cannot_be_built_are_refused(text: str) -> None:
    told = manifest_error(text)
    assert len(told) < 1_000
    assert told.isprintable()


def test_tags_and_aliases_are_named() -> None:
    assert "tags (!) are not allowed" in manifest_error(MANIFEST.replace("test policy", "!!str test"))
    assert "aliases (*) are not allowed" in manifest_error(MANIFEST.replace("test policy", "&a test"))


@pytest.mark.parametrize("name", ["2001-01-01", "=", "<<"])
def test_what_only_looks_like_a_date_or_merge_key_is_text(name: str) -> None:
    assert parse_manifest(MANIFEST.replace("test policy", name).encode()).name == name


@pytest.mark.parametrize(
    ("text", "told"), [("[" * 9, "nested more than 8"), ("- a\n" * 1_001, "more than 1000 values")]
)
def test_too_many_or_too_deep_values_are_refused(text: str, told: str) -> None:
    assert told in manifest_error(text)


SCRAPS = [*"[]{}:,-?&*!|>'\"#%@`~=<\n \t\r\0\ufeff\x85", *MANIFEST.splitlines(keepends=True)]
SCRAPS += [
    "&a ", "*a ", "!!pairs ", "!!set ", "!!omap ", "!<x> ", "<<: ", "? ", "- ", "--- ", "...\n", "%YAML 1.1\n", ": ",
    "0b_", "1_", "0x_", "1:60", "1e999", ".inf", ".nan", "null", "2001-99-99", '"\\ud800"', '"\\x00"', "9" * 5_000,
]  # fmt: skip
texts = st.lists(st.sampled_from(SCRAPS) | st.text(max_size=5), max_size=12).map("".join)


@st.composite
def manifests(draw: st.DrawFn) -> bytes:
    """Something, then something many times, then something."""
    middle = draw(texts)
    times = draw(st.integers(0, 16 * 1024 // max(1, len(middle.encode("utf-8", "ignore")))))
    return (draw(texts) + middle * times + draw(texts)).encode("utf-8", "ignore")


@pytest.mark.slow
@settings(max_examples=300, suppress_health_check=[HealthCheck.too_slow])
@given(st.binary(max_size=17_000) | manifests())
@example(ALIASES_UNDER_PAIRS.encode())
@example(b"{" * 16_000)
@example(b"[" + b"a," * 8_000 + b"]")
def test_a_manifest_is_read_or_refused_quickly_and_in_little_memory(data: bytes) -> None:
    started_s = time.thread_time()
    with contextlib.suppress(ManifestRejected):
        parse_manifest(data)
    assert time.thread_time() - started_s < 0.5
    tracemalloc.start()  # Only now: it slows reading down several times.
    try:
        with contextlib.suppress(ManifestRejected):
            parse_manifest(data)
        _, peak_bytes = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak_bytes < 50e6


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


@pytest.fixture
def second_track(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A track "mine" with the folder "Mine" and the task "my-peg", which comes before track_1."""
    content = yaml.safe_load((Path(registry.__file__).parent / "track_1.yaml").read_text())
    del content["combination_rule"]
    task = content["tasks"]["peg-insertion"] | {"name": "my-peg"}
    folder = tmp_path / "tracks"
    folder.mkdir()
    (folder / "mine.yaml").write_text(
        yaml.safe_dump(content | {"name": "mine", "folder": "Mine", "tasks": {"my-peg": task}})
    )
    monkeypatch.setenv("VITAC_TRACKS_DIR", str(folder))


@pytest.mark.usefixtures("second_track")
@pytest.mark.parametrize("read", [read_manifest_file, lambda archive: stage(archive, archive.parent / "out")])
def test_top_folder_of_another_track_is_refused(tmp_path: Path, read: Callable[[Path], object]) -> None:
    archive = tmp_path / "s.zip"
    archive.write_bytes(submission_zip(top="Mine"))
    with pytest.raises(ArchiveRejected, match="names track_1: expected folder Track_1, got Mine") as caught:
        read(archive)
    assert caught.value.code is ArchiveFault.WRONG_TOP_FOLDER
    assert not (tmp_path / "out").exists()


@pytest.mark.usefixtures("second_track")
def test_unpacked_folder_of_another_track_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ArchiveRejected, match="expected folder Track_1, got Mine"):
        load_unpacked_manifest(unpack(io.BytesIO(submission_zip(top="Mine")), tmp_path / "out"))
    assert load_unpacked_manifest(unpack(io.BytesIO(submission_zip()), tmp_path / "right")).track == "track_1"


@pytest.mark.usefixtures("second_track")
def test_a_staged_folder_has_the_name_of_its_track(tmp_path: Path) -> None:
    mine = {**FILES, "submission.yaml": "track: mine\ntasks: [my-peg]\nname: x\n"}
    assert stage(submission_folder(tmp_path / "1"), tmp_path / "out_1").name == "Track_1"
    assert stage(submission_folder(tmp_path / "2", mine), tmp_path / "out_2").name == "Mine"


def test_wrong_name_of_the_manifest_lists_the_files_that_are_there(tmp_path: Path) -> None:
    folder = submission_folder(tmp_path)
    (folder / "submission.yaml").rename(folder / "submission.yml")
    mend = r"; rename 'submission\.yml' to submission\.yaml\."
    with pytest.raises(NoSubmission, match=rf"holds 'policy\.py', .*'submission\.yml'{mend}"):
        find_submission(folder)
    with pytest.raises(ManifestRejected, match=rf"folder holds 'policy\.py', .*'submission\.yml'{mend}"):
        load_manifest(folder)
    archive = tmp_path / "packed.zip"
    archive.write_bytes(zip_bytes({"Track_1/submission.yml": MANIFEST, "Track_1/policy.py": ""}))
    with pytest.raises(ManifestRejected, match=rf"{mend} The archive holds 'policy\.py', 'submission\.yml'\."):
        read_manifest_file(archive)


def test_the_folder_of_a_track_that_this_machine_lacks_is_named(tmp_path: Path) -> None:
    submission_folder(tmp_path / "Mine")
    with pytest.raises(NoSubmission, match=r"; folder 'Mine' holds one, but no track .* Track_1, .*VITAC_TRACKS_DIR"):
        find_submission(tmp_path)


def test_a_manifest_of_the_right_name_is_not_to_be_renamed(tmp_path: Path) -> None:
    (tmp_path / "submission.yaml").mkdir()
    with pytest.raises(NoSubmission, match=r"name the submission's folder or its zip\.$"):
        find_submission(tmp_path)
    archive = tmp_path / "packed.zip"
    archive.write_bytes(zip_bytes({"Track_1/submission.yaml": "#" * 20_000}))
    with pytest.raises(ManifestRejected, match=r"; put it directly into the submission's folder\. The archive holds"):
        read_manifest_file(archive)


def test_wrong_name_of_a_submission_lists_what_lies_beside_it(tmp_path: Path) -> None:
    (tmp_path / "heuristic").mkdir()
    with pytest.raises(NoSubmission, match=r"huristic does not exist; folder .* holds 'heuristic'\."):
        find_submission(tmp_path / "huristic")


CUBES = "track: maniskill\ntasks: [pick-cube, push-cube]\nname: cubes\n"


def test_control_modes_are_those_of_the_tasks_or_are_not_named() -> None:
    assert parse_manifest(CUBES.encode()).control_modes == {}
    named = parse_manifest(f"{CUBES}control_modes: {{push-cube: pd_ee_delta_pos}}\n".encode())
    assert named.control_modes == {"push-cube": "pd_ee_delta_pos"}


@pytest.mark.parametrize(
    ("manifest", "named", "expected"),
    [
        (CUBES, "pick-cube: pd_joint_delta_pos", "has 'pd_joint_delta_pos' for pick-cube, expected 'pd_ee_delta_pos'"),
        (CUBES, "stack-cube: pd_ee_delta_pose", "names 'stack-cube', expected one of its tasks: pick-cube, push-cube."),
        (CUBES, "nothing: pd_ee_delta_pos", "names 'nothing', expected one of its tasks: pick-cube, push-cube."),
        (CUBES, "pick-cube: ''", "control_modes"),
        (CUBES, "pick-cube: [pd_ee_delta_pos]", "control_modes"),
        (CUBES, ", ".join(f"t{index}: m" for index in range(17)), "control_modes"),
        (MANIFEST, "peg-insertion: pd_ee_delta_pos", "for peg-insertion, which has no control modes."),
    ],
)  # fmt: skip
def test_a_control_mode_that_is_not_the_tasks_is_refused_with_the_tasks_own(
    manifest: str, named: str, expected: str
) -> None:
    error = manifest_error(f"{manifest}control_modes: {{{named}}}\n")
    assert expected in error
    assert "control_modes" in error


REMOTE_MANIFEST = MANIFEST.replace("entry_point: policy:Policy\n", "")


def test_keys_of_a_policy_server_are_those_that_are_sent() -> None:
    names = "{state: relative_motion, touch: marker_flow, again: marker_flow}"
    manifest = parse_manifest(f"{REMOTE_MANIFEST}remote: {{protocol: openpi, observations: {names}}}\n".encode())
    assert manifest.read_keys == ("relative_motion", "marker_flow")
    assert manifest.server().execute == 1


@pytest.mark.parametrize(
    ("remote", "words"),
    [
        ("{protocol: grpc}", "remote.protocol"),
        ("{protocol: openpi, observations: {a: gt_offset}}", "remote.observations has 'gt_offset', expected each once"),
        ("{protocol: openpi, observations: {a: {key: marker_flow, size: [2, 2]}}}", "marker_flow is no picture"),
        ("{protocol: openpi, observations: {a: {key: marker_flow, size: [0, 2]}}}", "size"),
        ("{protocol: openpi, execute: 0}", "remote.execute"),
        ("{protocol: openpi, adress: 1}", "adress"),
    ],
)
def test_wrong_description_of_a_policy_server_is_refused(remote: str, words: str) -> None:
    assert words in manifest_error(f"{REMOTE_MANIFEST}remote: {remote}\n")


@pytest.mark.parametrize("key", ["entry_point: policy:Policy", "observation_keys: [marker_flow]"])
def test_what_a_policy_server_does_not_use_is_refused(key: str) -> None:
    error = manifest_error(f"{REMOTE_MANIFEST}{key}\nremote: {{protocol: openpi}}\n")
    assert f"{key.partition(':')[0]} is of a policy of the folder's own" in error


def test_policy_server_has_no_entry_point() -> None:
    manifest = parse_manifest(f"{REMOTE_MANIFEST}remote: {{protocol: openpi}}\n".encode())
    with pytest.raises(ManifestRejected, match="vitac evaluate --remote"):
        manifest.own_entry_point()


def test_folder_without_a_policy_server_says_what_to_add() -> None:
    with pytest.raises(ManifestRejected, match="no section `remote`"):
        parse_manifest(MANIFEST.encode()).server()
