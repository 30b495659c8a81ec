"""A kernel's digest covers exactly what its machine code is made from."""

import ast
import shutil
from pathlib import Path

import pytest
import vitac.envs
from vitac.envs.compilation.sources import find_imports, imported_modules, source_digest

FOLDER = Path(vitac.envs.__file__).parent
SOURCES = {
    "compilation/numba_internals.py": "",
    "constants.py": "LIMIT = 1.0\n",
    "fem/__init__.py": "",
    "fem/vectors.py": "from ..constants import LIMIT\n",
    "fem/forces.py": "from .vectors import LIMIT\n",
    "fem/solver.py": "import vitac.envs.fem.forces\n",
    "gel.py": "from vitac.envs.constants import LIMIT\n",
    "camera.py": "from math import pi\n",
}
MODULES = ("fem/vectors.py", "fem/forces.py", "fem/solver.py", "gel.py", "camera.py")


@pytest.fixture
def envs(tmp_path: Path) -> Path:
    for name, text in SOURCES.items():
        path = tmp_path / "envs" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return tmp_path / "envs"


def digests(envs: Path) -> dict[str, str]:
    return {module: source_digest(envs / module, envs) for module in MODULES}


@pytest.mark.parametrize(
    ("changed", "dependents"),
    [
        ("constants.py", {"fem/vectors.py", "fem/forces.py", "fem/solver.py", "gel.py"}),
        ("fem/vectors.py", {"fem/vectors.py", "fem/forces.py", "fem/solver.py"}),
        ("fem/solver.py", {"fem/solver.py"}),
        ("camera.py", {"camera.py"}),
        ("compilation/numba_internals.py", set(MODULES)),
    ],
)
def test_a_change_reaches_exactly_the_modules_that_import_it(envs: Path, changed: str, dependents: set[str]) -> None:
    copy = envs.parent / "changed"
    shutil.copytree(envs, copy)
    (copy / changed).write_text(SOURCES[changed] + "# changed\n")
    before, after = digests(envs), digests(copy)
    assert {module for module in MODULES if before[module] != after[module]} == dependents


def test_the_solver_depends_on_modules_without_kernels_too() -> None:
    found = {path.relative_to(FOLDER).as_posix() for path in imported_modules(FOLDER / "fem/solver/newton.py")}
    assert {"fem/model/model.py", "fem/contact/barrier.py", "deterministic_math.py"} <= found
    assert not {path for path in found if path.startswith(("tasks/", "drawing/", "geometry/"))}


def test_a_circle_of_imports_ends(tmp_path: Path) -> None:
    (tmp_path / "compilation").mkdir()
    (tmp_path / "a.py").write_text("from . import b\n")
    (tmp_path / "b.py").write_text("from .a import x\n")
    assert imported_modules(tmp_path / "a.py", tmp_path) == {tmp_path / "a.py", tmp_path / "b.py"}


def test_all_imports_of_our_modules_are_seen() -> None:
    """They are found by their first words; a module may name them in a way of its own."""
    for module in FOLDER.rglob("*.py"):
        imports = (ast.Import, ast.ImportFrom)
        parsed = {ast.unparse(node) for node in ast.walk(ast.parse(module.read_bytes())) if isinstance(node, imports)}
        assert {ast.unparse(node) for node in find_imports(module)} == parsed, module
