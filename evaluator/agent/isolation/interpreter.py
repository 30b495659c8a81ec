"""Which files make up the Python that a policy runs on, and where they appear inside the sandbox."""

import sys
import sysconfig
from dataclasses import dataclass
from pathlib import Path
from typing import Final

INSIDE_PYTHON: Final = Path("/opt/vitac/python")
INSIDE_PACKAGES: Final = Path("/opt/vitac/packages")


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
    """Inside; folders that are hidden, such as the evaluator's own code."""


def current() -> Interpreter:
    """Return the interpreter and packages of this process.

    A Python below /usr is seen at its own place; any other (pyenv, conda, a home folder that the sandbox's user could
    not even enter) is bound to a neutral path.
    """
    prefix = Path(sys.base_prefix).resolve()
    executable = Path(getattr(sys, "_base_executable", sys.executable)).resolve()
    packages = tuple(dict.fromkeys(Path(sysconfig.get_path(key)).resolve() for key in ("purelib", "platlib")))
    inside_packages = tuple(INSIDE_PACKAGES / str(number) for number in range(len(packages)))
    binds = list(zip(packages, inside_packages, strict=True))
    library_folder = None
    if not prefix.is_relative_to("/usr"):
        binds.insert(0, (prefix, INSIDE_PYTHON))
        executable = INSIDE_PYTHON / executable.relative_to(prefix)
        library_folder = INSIDE_PYTHON / "lib"
    masked = tuple(
        inside / "vitac"
        for outside, inside in zip(packages, inside_packages, strict=True)
        if (outside / "vitac").is_dir()
    )
    return Interpreter(
        executable=executable,
        packages=inside_packages,
        library_folder=library_folder,
        read_only_binds=tuple(binds),
        masked=masked,
    )
