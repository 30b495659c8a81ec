"""Finds the Python and the installed packages that a policy runs on, and where they appear inside the sandbox.

Each package is mounted by itself, and nothing beside it: what else is installed beside the evaluator (for pages,
documentation, drawing, training, tests) is not in the sandbox.
"""

import re
import sys
import sysconfig
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Final

from ...package_sets import PackageSet, locked_versions, shown_sets
from ..runtime.agent import WHEELS_FOLDER

INSIDE_PACKAGES: Final = Path("/opt/vitac/packages")


@dataclass(frozen=True, kw_only=True)
class PolicyPackages:
    """The installed packages of some sets.

    Attributes:
        versions: by package.
        binds: (outside, inside) of every file and folder that belongs to them.
    """

    versions: Mapping[str, str]
    binds: tuple[tuple[Path, Path], ...]


def find_packages(sets: tuple[PackageSet, ...], folders: tuple[Path, ...]) -> PolicyPackages:
    """Return the packages of the sets that are installed in some folders of packages."""
    return _found(sets, tuple((folder, folder.stat().st_mtime_ns) for folder in folders))


@cache
def _found(sets: tuple[PackageSet, ...], folders: tuple[tuple[Path, int], ...]) -> PolicyPackages:
    """Return the packages in folders, each with the time of its last change, as every installation changes it."""
    wanted = locked_versions(sets).keys()
    versions: dict[str, str] = {}
    binds: list[tuple[Path, Path]] = []
    for number, (folder, _) in enumerate(folders):
        seen, unseen = [], []
        for name, version, files in _distributions(folder):
            if name in wanted and name not in versions:
                versions[name] = version
                seen += files
            else:
                unseen += files
        for path in _covering(seen, unseen):
            if (folder / path).exists() and not path.endswith(".pth"):
                binds.append((folder / path, INSIDE_PACKAGES / str(number) / path))
    return PolicyPackages(versions=dict(sorted(versions.items())), binds=tuple(sorted(binds)))


def _distributions(folder: Path) -> Iterator[tuple[str, str, list[str]]]:
    """Yield name, version and files of every distribution in a folder; one without a list of files cannot be shown."""
    for info in sorted(folder.glob("*.dist-info")):
        try:
            record = (info / "RECORD").read_text(encoding="utf-8")
        except OSError:
            continue
        files = [line.rsplit(",", 2)[0].strip('"') for line in record.splitlines()]
        inside = [path for path in files if not path.startswith(("..", "/"))]
        yield *_parse_name(info), inside


def _parse_name(info: Path) -> tuple[str, str]:
    """Return name and version of the distribution that a folder describes."""
    name, _, version = info.stem.rpartition("-")
    return re.sub(r"[-_.]+", "-", name).lower(), version


def _covering(seen: Iterable[str], unseen: Iterable[str], above: str = "") -> Iterator[str]:
    """Yield files and folders that together hold all seen paths and none of the unseen ones, as few as possible."""
    shared = _group_by_first_part(unseen)
    for first, rest in _group_by_first_part(seen).items():
        if first not in shared or "" in rest:
            yield above + first
        else:
            yield from _covering(rest, filter(None, shared[first]), f"{above}{first}/")


def _group_by_first_part(paths: Iterable[str]) -> dict[str, list[str]]:
    parts: dict[str, list[str]] = {}
    for path in paths:
        first, _, rest = path.partition("/")
        parts.setdefault(first, []).append(rest)
    return parts


INSIDE_PYTHON: Final = Path("/opt/vitac/python")
_FOLDERS_OF_PACKAGES: Final = ("lib/python3*/dist-packages", "lib*/python3*/site-packages")


@dataclass(frozen=True, kw_only=True)
class Interpreter:
    """A Python installation and its packages, as seen from outside and from inside."""

    executable: Path
    """Inside."""
    packages: tuple[Path, ...]
    """Inside; put on `sys.path` in this order."""
    library_folder: Path | None
    """Inside; where a shared libpython lies that the loader would not find by itself."""
    read_only_binds: tuple[tuple[Path, Path], ...]
    """(outside, inside)."""
    masked: tuple[Path, ...]
    """Inside; folders that are hidden: the packages that are installed for any Python of the machine."""


def installed_packages(declared: Iterable[PackageSet] = ()) -> PolicyPackages:
    """Return the packages that policies see here, where their track declares these sets."""
    return find_packages(shown_sets(declared), package_folders())


def policy_versions(submission_dir: Path, declared: Iterable[PackageSet]) -> dict[str, str]:
    """Return the versions of all packages that a submission's policy can import here, those of its own wheels first."""
    own = dict(_parse_name(info) for info in (submission_dir / WHEELS_FOLDER).glob("*.dist-info"))
    return dict(sorted({**installed_packages(declared).versions, **own}.items()))


def find_interpreter(declared: Iterable[PackageSet] = ()) -> Interpreter:
    """Return the interpreter of this process, with the packages that policies see.

    A Python below /usr is seen at its own place; any other (pyenv, conda, a home folder that the sandbox's user could
    not even enter) is bound to a neutral path.
    """
    prefix = Path(sys.base_prefix).resolve()
    executable = Path(getattr(sys, "_base_executable", sys.executable)).resolve()
    binds: list[tuple[Path, Path]] = []
    masked = [folder for root in (Path("/usr"), Path("/usr/local")) for folder in _folders_below(root)]
    library_folder = None
    if not prefix.is_relative_to("/usr"):
        binds.append((prefix, INSIDE_PYTHON))
        executable = INSIDE_PYTHON / executable.relative_to(prefix)
        library_folder = INSIDE_PYTHON / "lib"
        masked += [INSIDE_PYTHON / folder.relative_to(prefix) for folder in _folders_below(prefix)]
    return Interpreter(
        executable=executable,
        packages=tuple(INSIDE_PACKAGES / str(number) for number in range(len(package_folders()))),
        library_folder=library_folder,
        read_only_binds=(*binds, *installed_packages(declared).binds),
        masked=tuple(dict.fromkeys(masked)),
    )


def package_folders() -> tuple[Path, ...]:
    """Return where packages are installed beside this process."""
    return tuple(dict.fromkeys(Path(sysconfig.get_path(key)).resolve() for key in ("purelib", "platlib")))


def _folders_below(prefix: Path) -> list[Path]:
    """Return where packages are installed below a prefix; a folder that is a link is hidden where it leads."""
    folders = (folder for pattern in _FOLDERS_OF_PACKAGES for folder in prefix.glob(pattern) if folder.is_dir())
    return sorted({folder.resolve() for folder in folders if folder.resolve().is_relative_to(prefix)})
