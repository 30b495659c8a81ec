"""Which files make up the Python that a policy runs on, and where they appear inside the sandbox."""

import sys
import sysconfig
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from ...package_sets import PackageSet, shown_sets
from .packages import INSIDE_PACKAGES, PolicyPackages, find_packages

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
    return find_packages(shown_sets(declared), _package_folders())


def current(declared: Iterable[PackageSet] = ()) -> Interpreter:
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
        packages=tuple(INSIDE_PACKAGES / str(number) for number in range(len(_package_folders()))),
        library_folder=library_folder,
        read_only_binds=(*binds, *installed_packages(declared).binds),
        masked=tuple(dict.fromkeys(masked)),
    )


def _package_folders() -> tuple[Path, ...]:
    return tuple(dict.fromkeys(Path(sysconfig.get_path(key)).resolve() for key in ("purelib", "platlib")))


def _folders_below(prefix: Path) -> list[Path]:
    """Return where packages are installed below a prefix; a folder that is a link is hidden where it leads."""
    found = (folder for pattern in _FOLDERS_OF_PACKAGES for folder in prefix.glob(pattern) if folder.is_dir())
    return sorted({folder.resolve() for folder in found if folder.resolve().is_relative_to(prefix)})
