"""What a kernel's machine code depends on: its module, all that this imports of ours, and the compiler."""

import ast
import hashlib
import platform
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import llvmlite  # type: ignore[import-untyped]
import numba
import numpy as np

_ENVS = Path(__file__).parent.parent
_PACKAGE = "vitac.envs"
_IMPORT = re.compile(r"^[ \t]*((?:from [\w.]+ )?import (?:\([^)]*\)|[\w., *]+))", re.MULTILINE)
"""Parsing whole modules takes a sixth of the time in which an evaluation starts."""


def source_digest(module: Path, envs: Path = _ENVS) -> str:
    """Return the SHA-256 [hex] of a module, of all modules of `vitac.envs` that it imports, and of what compiles it.

    A kernel freezes the kernels it calls, constants and field orders of the modules it imports from, whether they hold
    kernels or not, and so on for theirs. Neither the folder they stand in nor their times matter, so that two clones
    share machine code. Modules elsewhere, like those of tests, must not take kernels from each other.
    """
    sources = imported_modules(module, envs) | set((envs / "compilation").glob("*.py"))
    digest = hashlib.sha256(_compiler().encode())
    for path in sorted(sources - {module}):
        digest.update(path.relative_to(envs).as_posix().encode() + b"\0" + _file_digest(path))
    digest.update(_file_digest(module))
    return digest.hexdigest()


def imported_modules(module: Path, envs: Path = _ENVS) -> set[Path]:
    """Return all files of `vitac.envs` that a module imports, directly or through others."""
    paths: set[Path] = set()
    waiting = [module]
    while waiting:
        for path in _imports(waiting.pop(), envs):
            if path not in paths:
                paths.add(path)
                waiting.append(path)
    return paths


def _compiler() -> str:
    """Return the versions that decide on machine code; Numba itself keeps builds for different CPUs apart."""
    versions = {"numba": numba.__version__, "llvmlite": llvmlite.__version__, "numpy": np.__version__}
    return f"python {platform.python_version()} {versions}"


@cache
def read_source(path: Path) -> bytes:
    """Return a file as first read: a kernel is compiled later, and the file may have changed by then."""
    return path.read_bytes()


@cache
def _file_digest(path: Path) -> bytes:
    return hashlib.sha256(read_source(path)).digest()


def find_imports(module: Path) -> list[ast.stmt]:
    """Return the imports anywhere in a module."""
    return ast.parse("\n".join(_IMPORT.findall(read_source(module).decode()))).body


@cache
def _imports(module: Path, envs: Path) -> frozenset[Path]:
    """Return the files of `vitac.envs` that a module names in its imports."""
    paths: set[Path] = set()
    for node in find_imports(module):
        if isinstance(node, ast.ImportFrom):
            paths.update(_list_source_files(node, module, envs))
        elif isinstance(node, ast.Import):
            for alias in node.names:
                if alias.name.startswith(f"{_PACKAGE}."):
                    paths.update(_find_source_file(envs.joinpath(*alias.name.split(".")[2:])))
    return frozenset(paths)


def _list_source_files(node: ast.ImportFrom, module: Path, envs: Path) -> Iterator[Path]:
    """Return the files of `from package import a, b`: of the package, and of a and b where these are modules."""
    names = (node.module or "").split(".") if node.module else []
    if node.level:
        base = module.parents[node.level - 1].joinpath(*names)
    elif names[:2] == _PACKAGE.split("."):
        base = envs.joinpath(*names[2:])
    else:
        return
    yield from _find_source_file(base)
    for alias in node.names:
        yield from _find_source_file(base / alias.name)


def _find_source_file(base: Path) -> Iterator[Path]:
    for path in (base.with_name(f"{base.name}.py"), base / "__init__.py"):
        if path.is_file():
            yield path


# All are read now, as modules with kernels are about to be imported.
for _path in _ENVS.rglob("*.py"):
    read_source(_path)
