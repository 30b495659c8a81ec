import platform
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from vitac.evaluator import version


def test_hash_is_stable_within_and_across_processes() -> None:
    command = [sys.executable, "-c", "from vitac.evaluator.version import evaluator_hash; print(evaluator_hash())"]
    other = subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()
    assert other == version.evaluator_hash()


def test_version_names_release_and_hash() -> None:
    assert version.evaluator_version() == f"{version.EVALUATOR_RELEASE}+{version.evaluator_hash()[:12]}"


@pytest.mark.parametrize(
    ("machine", "expected"),
    [
        ("x86_64", "ieee754-linux"),
        ("aarch64", "ieee754-linux"),
        ("AMD64", "ieee754-linux"),
        ("riscv64", "riscv64-linux"),
    ],
)
def test_architectures_that_give_the_same_bits_are_of_one_class(
    monkeypatch: pytest.MonkeyPatch, machine: str, expected: str
) -> None:
    monkeypatch.setattr(platform, "machine", lambda: machine)
    monkeypatch.setattr(platform, "system", lambda: "Linux")
    assert version.platform_class() == expected


def test_hash_needs_no_simulation_libraries() -> None:
    code = (
        "import sys; from vitac.evaluator.version import evaluator_version; evaluator_version();"
        "print([name for name in ('numba', 'gymnasium', 'numpy') if name in sys.modules])"
    )
    assert subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout == "[]\n"


@pytest.fixture
def copied_sources(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of the hashed packages that a test may change."""
    for package in ("envs", "evaluator"):
        source = version._package_path(f"vitac.{package}")
        shutil.copytree(source, tmp_path / package, ignore=shutil.ignore_patterns("__pycache__"))
    monkeypatch.setattr(version, "_package_path", lambda package: tmp_path / package.removeprefix("vitac."))
    return tmp_path


def fresh_hash() -> str:
    return version.evaluator_hash.__wrapped__()


def test_hash_does_not_depend_on_where_the_sources_lie(copied_sources: Path) -> None:
    assert fresh_hash() == version.evaluator_hash()


def test_hash_ignores_files_that_are_not_packaged_sources(copied_sources: Path) -> None:
    before = fresh_hash()
    (copied_sources / "envs" / "__pycache__").mkdir()
    (copied_sources / "envs" / "__pycache__" / "x.cpython-311.pyc").write_bytes(b"x")
    (copied_sources / "evaluator" / "notes.txt").write_text("x")
    assert fresh_hash() == before


def test_hash_of_one_packages_sources_changes_with_them_alone(copied_sources: Path) -> None:
    before = {package: version.sources_hash(f"vitac.{package}") for package in ("envs", "evaluator")}
    (copied_sources / "envs" / "notes.txt").write_text("x")
    assert version.sources_hash("vitac.envs") == before["envs"]
    (copied_sources / "envs" / "extras.py").write_text("")
    assert version.sources_hash("vitac.envs") != before["envs"]
    assert version.sources_hash("vitac.evaluator") == before["evaluator"]
    assert len(set(before.values())) == 2


@pytest.mark.parametrize("name", ["envs/extras.py", "evaluator/tracks/track_1.yaml"])
def test_hash_changes_with_a_source(copied_sources: Path, name: str) -> None:
    before = fresh_hash()
    with (copied_sources / name).open("a") as file:
        file.write("\n")
    assert fresh_hash() != before


def test_hash_changes_when_a_source_is_renamed(copied_sources: Path) -> None:
    before = fresh_hash()
    (copied_sources / "envs" / "extras.py").rename(copied_sources / "envs" / "additions.py")
    assert fresh_hash() != before


def test_hash_changes_with_numpy_version(copied_sources: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = fresh_hash()
    monkeypatch.setattr(version, "version", lambda name: "9.9.9" if name == "numpy" else "0")
    assert fresh_hash() != before


def test_parts_name_all_that_is_hashed(copied_sources: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    read = version.evaluator_parts.__wrapped__
    before = read()
    assert before.keys() == {"llvmlite", "numba", "numpy", "vitac.envs", "vitac.evaluator"}
    (copied_sources / "envs" / "extras.py").write_text("")
    after = read()
    assert {name for name in after if after[name] != before[name]} == {"vitac.envs"}
    assert version.evaluator_parts() is version.evaluator_parts(), "each shard asks, and reading them takes 20 ms"
