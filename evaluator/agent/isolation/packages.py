"""Finds the installed packages that a policy sees, each mounted by itself, and nothing beside them.

What else is installed beside the evaluator (for pages, documentation, drawing, training, tests) is not in the sandbox.
"""

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Final

from ...package_sets import PackageSet, locked_versions

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
        name, _, version = info.stem.rpartition("-")
        try:
            record = (info / "RECORD").read_text(encoding="utf-8")
        except OSError:
            continue
        files = [line.rsplit(",", 2)[0].strip('"') for line in record.splitlines()]
        inside = [path for path in files if not path.startswith(("..", "/"))]
        yield re.sub(r"[-_.]+", "-", name).lower(), version, inside


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
