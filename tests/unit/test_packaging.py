"""What is installed: every package and data file, hash-checked locks, light imports, no address of one machine."""

import json
import os
import re
import subprocess
import sys
import tomllib
import zipfile
from collections.abc import Iterator
from importlib.metadata import packages_distributions
from pathlib import Path
from typing import Any

import pytest
import vitac.envs
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from vitac.cli.main import NOUNS
from vitac.envs.maniskill.definition import catalogue

FOLDERS = (
    "cli",
    "docs",
    "envs",
    "errors",
    "evaluator",
    "integrations",
    "migrations",
    "server",
    "station",
    "training",
    "web",
    "worker",
)
NOT_SHIPPED = {"__pycache__", "node_modules"}
URL_HOSTS = {
    "arxiv.org",
    "c2sp.org",
    "creativecommons.org",
    "doi.org",
    "gvisor.dev",
    "docs.astral.sh",
    "docs.ray.io",
    "github.com",
    "json-schema.org",
    "keepachangelog.com",
    "localhost",
    "semver.org",
    "tus.io",
    "spec.openapis.org",
    "www.apache.org",
    "www.rfc-editor.org",
    "www.w3.org",
}
RESERVED_HOST = re.compile(r"\w+|(.*\.)?(example|test|invalid)(\.(com|org|net))?|127(\.\d+){3}|\[::1\]|0\.0\.0\.0")


NEED_TORCH = [f"vitac.training.reference.{name}" for name in ("policy", "td3")]
NEED_HARNESSES = ["vitac.integrations.vla_eval"]
"""Loaded by the harnesses of others, which have them."""


@pytest.fixture(scope="module")
def project(repository: Path) -> dict[str, Any]:
    return tomllib.loads((repository / "pyproject.toml").read_text())


def shipped_files(repository: Path) -> Iterator[Path]:
    for folder in FOLDERS:
        for path in (repository / folder).rglob("*"):
            if path.is_file() and not NOT_SHIPPED & set(path.relative_to(repository).parts):
                yield path.relative_to(repository)


def committed_files(repository: Path) -> list[Path]:
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=repository, capture_output=True, check=False)
    if listed.returncode != 0:
        pytest.skip("not a git checkout: there is no list of committed files")
    return [repository / name for name in listed.stdout.decode().split("\0") if name and (repository / name).is_file()]


def committed_texts(repository: Path) -> Iterator[tuple[Path, str]]:
    for path in committed_files(repository):
        data = path.read_bytes()
        if b"\0" not in data:
            yield path.relative_to(repository), data.decode()


def modules_loaded_by(statement: str) -> set[str]:
    """The top-level modules of a fresh process after a statement."""
    names = "{name.partition('.')[0] for name in sys.modules}"
    # Neither looks for garbage nor takes down what was loaded: that is half of the time.
    code = f"import gc\ngc.disable()\n{statement}\nimport os, sys\nprint(*sorted({names}), flush=True)\nos._exit(0)"
    done = subprocess.run([sys.executable, "-P", "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return set(done.stdout.split())


def modules_below(repository: Path, folder: str) -> list[str]:
    paths = (path for path in shipped_files(repository) if path.parts[0] == folder and path.suffix == ".py")
    names = ("vitac." + ".".join(path.with_suffix("").parts).removesuffix(".__init__") for path in paths)
    return sorted(name for name in names if name.replace(".", "").isidentifier())


def test_every_folder_with_modules_is_a_listed_package(repository: Path, project: dict[str, Any]) -> None:
    modules = (path for path in shipped_files(repository) if path.suffix == ".py")
    folders = {Path("docs"), *(path.parent for path in modules)}
    assert sorted(project["tool"]["setuptools"]["packages"]) == sorted(
        "vitac." + ".".join(folder.parts) for folder in folders
    )


def test_every_top_level_package_is_mapped_to_its_folder(project: dict[str, Any]) -> None:
    assert project["tool"]["setuptools"]["package-dir"] == {f"vitac.{folder}": folder for folder in FOLDERS}


def test_wheel_holds_every_module_and_data_file(repository: Path, tmp_path: Path) -> None:
    source = tmp_path / "source"
    source.mkdir()
    for name in ("pyproject.toml", "README.md", "LICENSE", "NOTICE", *FOLDERS):
        (source / name).symlink_to(repository / name)
    code = "import sys; from setuptools import build_meta; print(build_meta.build_wheel(sys.argv[1]))"
    built = subprocess.run(
        [sys.executable, "-c", code, str(tmp_path)], cwd=source, capture_output=True, text=True, check=False
    )
    assert built.returncode == 0, built.stderr
    with zipfile.ZipFile(next(tmp_path.glob("*.whl"))) as wheel:
        held = {name.removeprefix("vitac/") for name in wheel.namelist() if name.startswith("vitac/")}
    assert held == {path.as_posix() for path in shipped_files(repository)}


def test_the_environments_say_the_version_of_the_distribution(project: dict[str, Any]) -> None:
    assert vitac.envs.__version__ == project["project"]["version"]


def test_server_imports_without_simulation_or_learning_libraries(repository: Path) -> None:
    loaded = modules_loaded_by("import " + ", ".join(modules_below(repository, "server")))
    assert "vitac" in loaded
    assert not loaded & {"torch", "sapien", "mani_skill", "numba", "scipy"}


def test_evaluator_imports_simulation_only_to_run(repository: Path) -> None:
    loaded = modules_loaded_by("import " + ", ".join(modules_below(repository, "evaluator")))
    assert not loaded & {"torch", "sapien", "mani_skill", "numba"}


def test_station_imports_without_the_libraries_of_its_devices(repository: Path) -> None:
    modules = modules_below(repository, "station")
    simulating = ("vitac.station.twin", "vitac.station.identification", "vitac.station.touch_gap")
    simulated = [module for module in modules if module.startswith(simulating)]
    assert not modules_loaded_by("import " + ", ".join(simulated)) & {"cv2", "pymodbus", "pyrealsense2", "serial"}
    loaded = modules_loaded_by("import " + ", ".join(set(modules) - set(simulated)))
    assert not loaded & {"cv2", "numba", "pymodbus", "pyrealsense2", "scipy", "serial"}


def test_no_task_of_ours_needs_what_the_extras_for_other_environments_bring() -> None:
    """Track 1, 2 and 3 play on a machine without torch, SAPIEN and ManiSkill."""
    play = (
        "import gymnasium, vitac.envs\n"
        "for env_id in vitac.envs.ENVIRONMENTS: gymnasium.make(env_id, disable_env_checker=True)"
    )
    loaded = modules_loaded_by(play)
    assert "numba" in loaded
    assert not loaded & {"torch", "sapien", "mani_skill"}


def import_names(requirements: list[str]) -> set[str]:
    """Top-level modules that packages bring."""
    wanted = {canonicalize_name(Requirement(each).name) for each in requirements}
    found = packages_distributions()
    return {module for module, names in found.items() if wanted & {canonicalize_name(name) for name in names}}


def test_environments_and_evaluation_need_no_extra(repository: Path, project: dict[str, Any]) -> None:
    """What `pip install` brings without extras runs the environments, the evaluator, training and their commands."""
    extras = project["project"]["optional-dependencies"]
    service = import_names(extras["server"])
    assert {"sqlalchemy", "fastapi", "psycopg", "alembic", "obstore"} <= service
    names = [f"vitac.cli.{noun.module or noun.name}" for noun in NOUNS if noun.extra is None]
    assert {"vitac.cli.evaluate", "vitac.cli.show", "vitac.cli.client.submit", "vitac.cli.doctor"} <= set(names)
    names += [name for folder in ("evaluator", "training") for name in modules_below(repository, folder)]
    assert set(NEED_TORCH) <= set(names)
    names = [name for name in names if name not in NEED_TORCH]
    names += [name for name in modules_below(repository, "envs") if ".drawing" not in name]
    assert not modules_loaded_by("import " + ", ".join(names)) & service


@pytest.mark.slow
def test_worker_needs_a_part_of_what_the_server_needs(repository: Path, project: dict[str, Any]) -> None:
    extras = project["project"]["optional-dependencies"]
    assert set(extras["worker"]) < set(extras["server"])
    loaded = modules_loaded_by("import " + ", ".join(modules_below(repository, "worker")))
    assert not loaded & (import_names(extras["server"]) - import_names(extras["worker"]))


def locked(repository: Path, profile: str) -> dict[str, set[str]]:
    """Versions by canonical name; several where a marker chooses between them."""
    text = (repository / "requirements" / f"{profile}.lock").read_text()
    versions: dict[str, set[str]] = {}
    for name, version in re.findall(r"^([A-Za-z0-9._-]+)(?:\[[^\]]*\])?==([^ \\;]+)", text, re.MULTILINE):
        versions.setdefault(canonicalize_name(name), set()).add(version)
    return versions


@pytest.mark.parametrize("profile", ["base", "server", "show", "station", "dev"])
def test_lock_satisfies_the_project(repository: Path, project: dict[str, Any], profile: str) -> None:
    wanted = list(project["project"]["dependencies"]) + project["build-system"]["requires"]
    wanted += project["project"]["optional-dependencies"].get(profile, [])
    versions = locked(repository, profile)
    for requirement in map(Requirement, wanted):
        chosen = versions.get(canonicalize_name(requirement.name), set())
        assert chosen, f"{requirement} is not in requirements/{profile}.lock: run setup/lock.sh"
        assert all(requirement.specifier.contains(version) for version in chosen), f"{requirement}: locked {chosen}"


def test_the_lock_of_evaluation_has_nothing_of_the_service(repository: Path, project: dict[str, Any]) -> None:
    service = {Requirement(each).name for each in project["project"]["optional-dependencies"]["server"]}
    assert service <= set(locked(repository, "server"))
    assert service & set(locked(repository, "base")) == {"markdown-it-py"}  # rich needs it too


EXTENDED = [
    ("base", "server"),
    ("base", "show"),
    ("server", "dev"),
    ("show", "dev"),
    ("base", "station"),
    ("station", "dev"),
]


@pytest.mark.parametrize(("smaller", "larger"), EXTENDED)
def test_larger_lock_extends_the_smaller_one(repository: Path, smaller: str, larger: str) -> None:
    held = locked(repository, larger)
    assert {name: held.get(name) for name in locked(repository, smaller)} == locked(repository, smaller)


@pytest.mark.parametrize(
    "profile", ["base", "server", "show", "station", "dev", "maniskill", "torch", "compat", "node"]
)
def test_lock_has_a_hash_for_every_package_and_names_no_index(repository: Path, profile: str) -> None:
    text = (repository / "requirements" / f"{profile}.lock").read_text()
    pinned = re.findall(r"^\S+==.*\\\n    --hash=sha256:[0-9a-f]{64}", text, re.MULTILINE)
    assert len(pinned) == len(re.findall(r"^\S+==", text, re.MULTILINE))
    assert "://" not in text
    assert "--index" not in text


def test_packages_of_the_player_have_a_hash_and_name_no_registry(repository: Path) -> None:
    text = (repository / "viewer" / "package-lock.json").read_text()
    wanted = json.loads((repository / "viewer" / "package.json").read_text())
    packages = json.loads(text)["packages"]
    for name, version in (wanted["dependencies"] | wanted["devDependencies"]).items():
        assert packages[f"node_modules/{name}"]["version"] == version
    for name, package in packages.items():
        assert not name or package["integrity"].startswith("sha512-"), name
    assert "://" not in text


@pytest.mark.parametrize(
    ("addition", "extra", "others"),
    [("maniskill", "maniskill", ("dev", "torch")), ("torch", "training", ("dev",)), ("compat", "compat", ("base",))],
)
def test_the_lock_of_an_addition_has_no_torch_and_agrees_with_all_others_on_what_they_share(
    repository: Path, project: dict[str, Any], addition: str, extra: str, others: tuple[str, ...]
) -> None:
    """It is installed into their environment; torch's build for CPUs is installed apart."""
    held = locked(repository, addition)
    for other in others:
        shared = locked(repository, other)
        assert {name: versions for name, versions in held.items() if versions != shared.get(name, versions)} == {}
    assert not [name for name in held if name in {"torch", "triton", "imageio-ffmpeg"} or name.startswith("cuda")]
    for requirement in map(Requirement, project["project"]["optional-dependencies"][extra]):
        if requirement.name != "torch":
            assert all(requirement.specifier.contains(version) for version in held[requirement.name])


def test_the_build_of_torch_for_cpus_is_one_that_the_extras_take(repository: Path, project: dict[str, Any]) -> None:
    pinned = re.search(r"^torch=(\S+)$", (repository / "setup" / "additions.sh").read_text(), re.MULTILINE)
    assert pinned
    for extra in ("torch", "training", "compat"):
        (wanted,) = (
            requirement
            for requirement in map(Requirement, project["project"]["optional-dependencies"][extra])
            if requirement.name == "torch"
        )
        assert wanted.specifier.contains(pinned[1])


def test_the_lock_of_maniskill_has_the_versions_that_its_catalogue_was_made_with(repository: Path) -> None:
    held = locked(repository, "maniskill")
    made_with = catalogue().made_with
    assert {name: held[name] for name in made_with} == {name: {version} for name, version in made_with.items()}


def test_lock_leaves_out_what_only_extras_need(repository: Path) -> None:
    assert not set(locked(repository, "dev")) & {"torch", "sapien", "mani-skill"}


def test_committed_files_name_only_known_hosts(repository: Path) -> None:
    unknown = []
    for path, text in committed_texts(repository):
        if path.parts[0] == "tests":  # hosts there are made up
            continue
        for host in re.findall(r"https?://(\[[0-9a-f:]+\]|[A-Za-z0-9.-]+)", text):
            if host.lower() not in URL_HOSTS and not RESERVED_HOST.fullmatch(host.lower()):
                unknown.append(f"{path}: {host}")
    assert unknown == [], "add a host that documents something to URL_HOSTS; package indexes are never named"


def test_committed_files_name_no_package_index(repository: Path) -> None:
    indexes = re.compile(r"\b(pypi|pythonhosted|npmjs|yarnpkg|debian|ubuntu)\.(org|com)\b")
    named = [str(path) for path, text in committed_texts(repository) if indexes.search(text)]
    assert named == []


def test_committed_files_name_no_folder_of_one_machine(repository: Path) -> None:
    machine = re.compile(r"(?<![\w.])/(work|home/[a-z]+|Users)/[a-z]")
    named = [f"{path}: {found[0]}" for path, text in committed_texts(repository) if (found := machine.search(text))]
    assert named == []


@pytest.mark.skipif("VITAC_EXPECT_WHEEL" not in os.environ, reason="looks at an installed wheel (.ci/run sets it up)")
def test_every_module_is_imported_from_the_wheel(repository: Path) -> None:
    names = [name for folder in FOLDERS for name in modules_below(repository, folder)]
    names = [name for name in names if name not in (*NEED_TORCH, *NEED_HARNESSES)]
    names = [name for name in names if not name.startswith("vitac.migrations.")]  # Alembic runs these
    files = f"import sys, {', '.join(names)}; print(*(sys.modules[name].__file__ for name in {names}), sep='\\n')"
    done = subprocess.run([sys.executable, "-P", "-c", files], capture_output=True, text=True, check=True)
    assert all("site-packages" in line for line in done.stdout.splitlines() if line != "None")


def test_tests_do_not_see_the_callers_settings(repository: Path) -> None:
    test = "tests/unit/test_packaging.py::test_top_level_environment_is_clean"
    done = subprocess.run(
        [sys.executable, "-P", "-m", "pytest", "-q", "-p", "no:cacheprovider", test],
        cwd=repository,
        env=os.environ
        | {"VITAC_DATABASE_URL": "postgresql://somebody@example.org/precious", "PYTHONDONTWRITEBYTECODE": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout


def test_top_level_environment_is_clean() -> None:
    assert "VITAC_DATABASE_URL" not in os.environ
    assert "PYTHONDONTWRITEBYTECODE" not in os.environ
    assert not sys.dont_write_bytecode
