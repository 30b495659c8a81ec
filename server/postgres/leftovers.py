"""What a server leaves behind whose starter was killed: processes and lock files. Called by `cluster`."""

import os
import signal
import time
from collections.abc import Iterable, Iterator
from contextlib import suppress
from pathlib import Path

import structlog

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
