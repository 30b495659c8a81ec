import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
from vitac.server.database.binaries import list_processes

SLEEP = "import sys, time; print(flush=True); time.sleep(600)"
FORK = (
    "import os, sys, time\n"
    "child = os.fork()\n"
    "if not child:\n"
    "    os.execv(sys.executable, ['postgres: idle', '-c', 'import time; time.sleep(600)'])\n"
    "print(child, flush=True)\n"
    "time.sleep(600)\n"
)


@pytest.fixture
def processes() -> Iterator[ExitStack]:
    with ExitStack() as stack:
        yield stack


@pytest.fixture
def hidden(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nobody may look up what a process runs and where, as without CAP_SYS_PTRACE."""
    readlink = Path.readlink

    def refuse(path: Path) -> Path:
        if path.name in {"exe", "cwd"}:
            raise PermissionError(13, "Permission denied")
        return readlink(path)

    monkeypatch.setattr(Path, "readlink", refuse)


def started(processes: ExitStack, code: str, *arguments: str, name: str = "/usr/bin/postgres") -> tuple[int, str]:
    """Starts a process with a command line of its own; its number and the line that it prints."""
    process = processes.enter_context(
        subprocess.Popen([name, "-c", code, *arguments], executable=sys.executable, stdout=subprocess.PIPE, text=True)
    )
    processes.callback(process.terminate)
    assert process.stdout is not None
    return process.pid, process.stdout.readline().strip()


@pytest.mark.usefixtures("hidden")
def test_server_is_known_by_its_command_line_where_its_folder_is_hidden(processes: ExitStack, tmp_path: Path) -> None:
    server, _ = started(processes, SLEEP, "-D", str(tmp_path))
    started(processes, SLEEP, "-D", str(tmp_path / "other"))
    started(processes, SLEEP, "-D", str(tmp_path), name="/usr/bin/backup")
    assert list(list_processes(tmp_path)) == [server]


@pytest.mark.usefixtures("hidden")
def test_backends_are_known_by_their_server(processes: ExitStack, tmp_path: Path) -> None:
    server, backend = started(processes, FORK, "-D", str(tmp_path))
    _, other = started(processes, FORK, "-D", str(tmp_path / "other"))
    for pid in (backend, other):
        processes.callback(os.kill, int(pid), signal.SIGKILL)
    assert sorted(list_processes(tmp_path)) == sorted([server, int(backend)])


def test_where_nothing_is_hidden_the_working_directory_decides(processes: ExitStack, tmp_path: Path) -> None:
    started(processes, SLEEP, "-D", str(tmp_path))
    assert list(list_processes(tmp_path)) == []
