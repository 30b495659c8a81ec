"""What an extra brings is named in one sentence where it is missing, whatever command needs it and whenever."""

import ast
import os
import subprocess
import sys
from collections.abc import Iterator
from importlib.metadata import requires
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from vitac.envs.extras import find_extra, install_command

FOLDERS = ("cli", "envs", "errors", "evaluator", "server", "station", "training", "web", "worker", "migrations")
ASKED_FOR = {"pytetwild", "segment_anything"}
"""Of no extra: their own messages say how to install them."""
NO_PACKAGES = {"agent", "compression"}
"""A file beside the one that imports it in the sandbox, and a part of the standard library from Python 3.14 on."""
HIDING = """
import sys
class Hidden:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {hidden!r}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)
sys.meta_path.insert(0, Hidden())
import importlib.util
find = importlib.util.find_spec
importlib.util.find_spec = lambda name, *rest: None if name in {hidden!r} else find(name, *rest)
from vitac.cli.main import main
main({words!r})
"""
STATION = {"cv2", "pymodbus", "serial", "rosbags", "cyclonedds"}
SERVER = {"sqlalchemy", "fastapi", "starlette", "uvicorn", "obstore", "alembic", "pydantic_settings", "structlog"}
WEB = {"fastapi", "starlette", "uvicorn", "jinja2", "markdown_it", "sse_starlette", "argon2", "multipart"}
"""What `server` has and `worker` has not."""
POLICY = "examples/peg_insertion_heuristic/Track_1"


def run(repository: Path, folder: Path, words: str, hidden: set[str], **variables: str) -> tuple[int, str]:
    done = subprocess.run(
        [sys.executable, "-c", HIDING.format(hidden=hidden, words=words.format(folder=folder).split())],
        cwd=repository,
        env=os.environ | {"VITAC_STATE_DIR": str(folder / "state")} | variables,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        check=False,
    )
    return done.returncode, done.stderr


@pytest.mark.slow
@pytest.mark.parametrize(
    ("words", "hidden", "extra"),
    [
        (f"evaluate {POLICY} --station twin --episodes 1", STATION, "station"),
        ("station listen --ros 2", STATION, "station"),
        ("station run pyproject.toml --key pyproject.toml", SERVER, "worker"),
        ("show peg-insertion --episode 1", {"matplotlib", "PIL"}, "show"),
        ("sensor show examples/track_3_dome/Track_3 --out {folder}/a.png", {"matplotlib", "PIL"}, "show"),
        ("serve", SERVER, "server"),
        ("worker", SERVER, "worker"),
        ("admin team list", SERVER, "server"),
        ("train reference peg-insertion --out {folder}/run", {"torch", "stable_baselines3"}, "training"),
        ("data collect peg-insertion --out {folder}/run --ray auto", {"ray"}, "ray"),
        ("evaluate examples/maniskill_cloning/ManiSkill --task pick-cube --episodes 1", {"mani_skill", "torch"}, None),
    ],
)
def test_a_missing_extra_is_one_sentence_with_the_remedy(
    repository: Path, tmp_path: Path, words: str, hidden: set[str], extra: str | None
) -> None:
    code, said = run(repository, tmp_path, words, hidden)
    assert (code, "Traceback" in said, "Aborted" in said) == (1, False, False), said
    assert said.splitlines()[-1].startswith("vitac: "), said
    assert install_command(extra or "maniskill") in said


@pytest.mark.slow
@pytest.mark.parametrize("words", [f"evaluate {POLICY} --episodes 1", "compile"])
def test_physics_that_may_not_be_compiled_is_one_sentence(repository: Path, tmp_path: Path, words: str) -> None:
    code, said = run(repository, tmp_path, words, set(), NUMBA_DISABLE_JIT="1")
    assert (code, "Traceback" in said) == (1, False), said
    assert "Unset it and run the command again" in said.splitlines()[-1]


@pytest.mark.slow
@pytest.mark.parametrize("words", ["competition apply competitions/vitac-2025.yaml", "results publish new"])
def test_organizers_elsewhere_need_nothing_of_the_server(repository: Path, tmp_path: Path, words: str) -> None:
    code, said = run(repository, tmp_path, f"admin --server http://127.0.0.1:9 {words}", SERVER)
    assert (code, "No service answers at http://127.0.0.1:9" in said) == (1, True), said


@pytest.mark.slow
def test_a_worker_needs_no_web_server(repository: Path, tmp_path: Path) -> None:
    code, said = run(
        repository,
        tmp_path,
        "worker --once",
        WEB,
        VITAC_DATABASE_URL="postgresql://127.0.0.1:9/vitac",
        VITAC_DATABASE_WAIT_S="1",
    )
    assert (code, "127.0.0.1" in said) == (75, True), said


def test_a_witness_needs_no_web_server(repository: Path, tmp_path: Path) -> None:
    code, said = run(repository, tmp_path, "witness key --name a.example/v --folder {folder}", SERVER)
    assert (code, said) == (0, "")


@pytest.mark.slow
def test_letters_that_a_terminal_lacks_end_no_command(repository: Path, tmp_path: Path) -> None:
    content = (repository / "competitions" / "vitac-2025.yaml").read_text().replace("title: ", "title: é", 1)
    (tmp_path / "cup.yaml").write_text(content)
    words = "admin competition check {folder}/cup.yaml --json"
    code, said = run(repository, tmp_path, words, set(), PYTHONIOENCODING="ascii")
    assert (code, said) == (0, "")


def imported(repository: Path) -> Iterator[str]:
    """Every package that some module of the product imports, wherever in it."""
    for path in (path for folder in FOLDERS for path in (repository / folder).rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ImportFrom) and not node.level and node.module:
                yield node.module
            elif isinstance(node, ast.Import):
                yield from (alias.name for alias in node.names)


@pytest.mark.slow
def test_every_import_is_of_the_base_or_of_an_extra_that_is_found(repository: Path) -> None:
    base = {Requirement(line).name for line in requires("vitac-arena") or () if "extra ==" not in line}
    packages = {name.partition(".")[0] for name in imported(repository)} - sys.stdlib_module_names
    packages -= ASKED_FOR | NO_PACKAGES
    known = {name.replace("-", "_") for name in base} | {"vitac", "yaml", "click", "_typeshed"}
    assert {name for name in packages - known if find_extra(name) is None} == set()
    assert len(packages - known) > 20
