"""What identifies the evaluator that made a result; called wherever a result is stored or compared.

Nothing here imports the environments: their sources are found and read, not run.
"""

import hashlib
import platform
from collections.abc import Mapping
from functools import cache
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path

EVALUATOR_RELEASE = "1"
"""Raised by hand when a change is meant to move scores, so that people can speak of it."""

_HASHED_PACKAGES = ("vitac.envs", "vitac.evaluator")
_HASHED_SUFFIXES = frozenset({".py", ".yaml"})
_HASHED_DISTRIBUTIONS = ("llvmlite", "numba", "numpy")


@cache
def evaluator_hash() -> str:
    """Return the SHA-256 [hex] of all that moves a score: our sources, and which NumPy, Numba and llvmlite.

    The same for a wheel and an editable installation of one tree, because only names and contents of files count. What
    tracks and tasks from elsewhere add for themselves says `vitac.evaluator.tracks.registry`.
    """
    digest = hashlib.sha256()
    for distribution in _HASHED_DISTRIBUTIONS:
        digest.update(f"{distribution}=={version(distribution)}\n".encode())
    for package in _HASHED_PACKAGES:
        _add_sources(digest, package)
    return digest.hexdigest()


@cache
def evaluator_parts() -> Mapping[str, str]:
    """Return what the hash is made of, by name: versions of distributions, and the hash of the sources of packages."""
    versions = {distribution: version(distribution) for distribution in _HASHED_DISTRIBUTIONS}
    return versions | {package: sources_hash(package) for package in _HASHED_PACKAGES}


def evaluator_version() -> str:
    """Return this evaluator's name, `<release>+<start of its hash>`; results of different ones are never mixed."""
    return format_version(evaluator_hash())


def format_version(sha256: str) -> str:
    """Return the version that has a hash: `<release>+<start of the hash>`."""
    return f"{EVALUATOR_RELEASE}+{sha256[:12]}"


def sources_hash(package: str) -> str:
    """Return the SHA-256 [hex] of the sources of a package, counted as those of the evaluator are.

    Raises:
        ModuleNotFoundError: the package is not installed.
    """
    digest = hashlib.sha256()
    _add_sources(digest, package)
    return digest.hexdigest()


_ALIKE = frozenset({"aarch64", "amd64", "arm64", "x86_64"})
"""Architectures whose states are equal to the last bit (docs/determinism.md, "Another architecture")."""


def platform_class() -> str:
    """Return the class of this machine, `ieee754-linux` almost always: those of one class give equal states."""
    machine = platform.machine().lower()
    return f"{'ieee754' if machine in _ALIKE else machine}-{platform.system().lower()}"


def _add_sources(digest: "hashlib._Hash", package: str) -> None:
    root = _package_path(package)
    if root.is_file():
        _add_file(digest, package, root)
        return
    files = sorted(
        (path.relative_to(root).as_posix(), path) for path in root.rglob("*") if path.suffix in _HASHED_SUFFIXES
    )
    for name, path in files:
        _add_file(digest, f"{package}/{name}", path)


def _add_file(digest: "hashlib._Hash", name: str, path: Path) -> None:
    content = path.read_bytes()
    digest.update(f"{name}\0{len(content)}\0".encode())
    digest.update(content)


def _package_path(package: str) -> Path:
    """Return the folder of a package, or the file of a single module."""
    spec = find_spec(package)
    if spec and spec.submodule_search_locations:
        return Path(next(iter(spec.submodule_search_locations)))
    if spec and spec.has_location and spec.origin:
        return Path(spec.origin)
    remedy = "install vitac-arena again" if package in _HASHED_PACKAGES else "install or remove what adds its task"
    raise ModuleNotFoundError(f"The package {package} is not installed; {remedy}.")
