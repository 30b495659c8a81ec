"""The system's files in memory, for policies that may not learn from the kernel's caches what others looked up or read.

A name that was looked up once on a disk answers faster afterwards, and so does a page that was read: both are shared by
all sandboxes of a machine, and outlast them. A tmpfs has nothing cold: its names and pages are in memory from the
beginning, and a name that is not there is not remembered. So one folder on a tmpfs holds all that policies see of the
system, filled once for each set of packages and shared, read-only, by all sandboxes; and the submission is copied into
a tmpfs of the sandbox's own, which numbers its files from the beginning.
"""

import fcntl
import hashlib
import json
import os
import re
import shutil
import subprocess
from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import contextmanager
from enum import StrEnum
from functools import cache
from pathlib import Path
from typing import Final

from ..verdicts import SandboxFailed
from .packages import INSIDE_PYTHON, Interpreter

FILES_VARIABLE: Final = "VITAC_SANDBOX_FILES"
FOLDER_VARIABLE: Final = "VITAC_MEMORY_DIR"
_DEFAULT_FOLDER: Final = Path("/dev/shm")  # noqa: S108 - a tmpfs is what is looked for
_MARGIN_BYTES: Final = 64 << 20
_PROGRAMS: Final = (
    "sh", "dash", "bash", "env", "prlimit", "setpriv", "[", "base64", "basename", "cat", "chmod", "cmp", "cp", "cut",
    "date", "dd", "dirname", "echo", "expr", "false", "find", "grep", "gzip", "head", "hostname", "id", "ln", "ls",
    "mkdir", "mktemp", "mv", "nproc", "printf", "pwd", "readlink", "realpath", "rm", "rmdir", "sed", "seq", "sleep",
    "sort", "stat", "tail", "tar", "tee", "test", "touch", "tr", "true", "uname", "uniq", "wc", "which", "xargs", "yes",
)  # fmt: skip
"""What a policy may call by `subprocess`, where the machine has it."""
_LIBRARIES: Final = (
    "libatomic.so.1", "libdl.so.2", "libgcc_s.so.1", "libgomp.so.1", "libm.so.6", "libnss_files.so.2",
    "libpthread.so.0", "libresolv.so.2", "librt.so.1", "libstdc++.so.6", "libutil.so.1",
)  # fmt: skip
"""Loaded by name while a program runs, so that nothing lists them."""
_DATA: Final = ("/usr/share/zoneinfo", "/usr/lib/locale/C.utf8", "/etc/ld.so.cache")
_LEFT_OUT_OF_PYTHON: Final = frozenset(
    {"site-packages", "dist-packages", "test", "tests", "idlelib", "ensurepip", "turtledemo", "include", "share"}
)
_FORMAT: Final = 2
"""Changes with what is put into the folder."""


class FileIsolation(StrEnum):
    """Where the files lie that a policy sees."""

    MEMORY = "memory"
    """In memory alone: no cache tells what was looked up or read before."""
    DISK = "disk"
    """On the machine's disks: names and pages that anybody has used answer faster."""


def default_file_isolation() -> FileIsolation:
    """Return what VITAC_SANDBOX_FILES names, by default the disk.

    Raises:
        SandboxFailed: it names something else.
    """
    named = os.environ.get(FILES_VARIABLE) or FileIsolation.DISK
    if named not in tuple(FileIsolation):
        raise SandboxFailed(f"Expected {FILES_VARIABLE} to be {' or '.join(FileIsolation)}, got {named!r:.80}.")
    return FileIsolation(named)


def memory_folder() -> Path:
    """Return the folder on a tmpfs that VITAC_MEMORY_DIR names, by default /dev/shm.

    Raises:
        SandboxFailed: it is not on a tmpfs, or this process cannot write there.
    """
    folder = Path(os.environ.get(FOLDER_VARIABLE) or _DEFAULT_FOLDER)
    remedy = f"name a folder on a tmpfs with 2 GB to spare in {FOLDER_VARIABLE}"
    kind = _file_system(folder)
    if kind != "tmpfs":
        raise SandboxFailed(f"Policies' files belong into memory, but {folder} is on {kind or 'nothing'}; {remedy}.")
    if not os.access(folder, os.W_OK | os.X_OK):
        raise SandboxFailed(f"Policies' files belong into memory, but {folder} cannot be written; {remedy}.")
    if os.statvfs(folder).f_flag & os.ST_NOEXEC:
        raise SandboxFailed(f"Programs of policies run from memory, but {folder} is mounted noexec; {remedy}.")
    return folder


def is_in_memory(folder: Path) -> bool:
    """Return whether a folder lies on a tmpfs."""
    return _file_system(folder) == "tmpfs"


def prepare_system_files(interpreter: Interpreter, *, own: Collection[tuple[Path, str]]) -> Path:
    """Return the folder in memory that holds what policies see of the system, each file below its path inside.

    It is filled by whoever asks first and stays for as long as a process uses it; then the next one that fills another
    removes it.

    Args:
        interpreter: Python and its packages.
        own: (outside, inside) of our own files in the sandbox.

    Raises:
        SandboxFailed: there is no such folder, or not enough room.
    """
    return _prepare(memory_folder(), interpreter, tuple(own))


@cache
def _prepare(memory: Path, interpreter: Interpreter, own: tuple[tuple[Path, str], ...]) -> Path:
    folder = memory / f"vitac-files-{os.geteuid()}-{_key(interpreter, own)}"
    with _locked(memory / f"vitac-files-{os.geteuid()}.lock", fcntl.LOCK_EX):
        _use(folder)
        if not (folder / "complete").exists():
            _remove_unused(memory, folder)
            _fill(folder, interpreter, own)
    return folder / "root"


def _key(interpreter: Interpreter, own: tuple[tuple[Path, str], ...]) -> str:
    """Return a hash over all that decides what is in the folder."""
    binds = [(str(outside), str(inside), outside.stat().st_mtime_ns) for outside, inside in interpreter.read_only_binds]
    files = [(inside, hashlib.sha256(outside.read_bytes()).hexdigest()) for outside, inside in own]
    return hashlib.sha256(json.dumps([_FORMAT, str(interpreter.executable), binds, files]).encode()).hexdigest()[:16]


@contextmanager
def _locked(file: Path, how: int) -> Iterator[int]:
    descriptor = os.open(file, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o600)
    try:
        fcntl.flock(descriptor, how)
        yield descriptor
    finally:
        os.close(descriptor)


def _use(folder: Path) -> None:
    """Make the folder, which has to be ours, and hold a lock on it until this process ends."""
    folder.mkdir(mode=0o755, exist_ok=True)
    state = folder.lstat()
    if state.st_uid != os.geteuid() or state.st_mode & 0o022 or folder.is_symlink():
        raise SandboxFailed(
            f"{folder} belongs to somebody else, so policies cannot run from it; ask them to remove it."
        )
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    fcntl.flock(descriptor, fcntl.LOCK_SH)  # never closed: it says that the folder is in use


def _remove_unused(memory: Path, wanted: Path) -> None:
    for folder in memory.glob(f"vitac-files-{os.geteuid()}-*"):
        if folder == wanted:
            continue
        descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            shutil.rmtree(folder, ignore_errors=True)
        except BlockingIOError:
            continue
        finally:
            os.close(descriptor)


def _fill(folder: Path, interpreter: Interpreter, own: tuple[tuple[Path, str], ...]) -> None:
    root = folder / "root"
    shutil.rmtree(root, ignore_errors=True)
    root.mkdir(mode=0o755)
    try:
        for outside, inside in interpreter.read_only_binds:
            _copy(outside, root / inside.relative_to("/"), _left_out_of_python if inside == INSIDE_PYTHON else None)
        if not any(inside == INSIDE_PYTHON for _, inside in interpreter.read_only_binds):
            _copy_system_python(interpreter, root)
        for file, path in own:
            _copy(file, root / path.lstrip("/"))
        for program in filter(None, (shutil.which(name, path="/usr/bin:/bin") for name in _PROGRAMS)):
            _copy_below_usr(Path(program), root)
        for data in map(Path, _DATA):
            if data.exists():
                _copy(data, root / data.relative_to("/"))
        _copy_libraries(root)
        _open_to_all(root)
        (folder / "submission").mkdir(mode=0o755, exist_ok=True)
        (folder / "complete").touch()
    except OSError as error:
        shutil.rmtree(root, ignore_errors=True)
        free = shutil.disk_usage(folder).free
        raise SandboxFailed(
            f"The files that policies see could not be copied into memory: {error.strerror or error}. "
            f"{folder.parent} has {free >> 20} MiB left; give it 2 GB, or name another tmpfs in {FOLDER_VARIABLE}."
        ) from error


def _copy(source: Path, target: Path, is_ignored: Callable[[str, list[str]], Iterable[str]] | None = None) -> None:
    target.parent.mkdir(parents=True, exist_ok=True, mode=0o755)
    if source.is_dir():
        shutil.copytree(source, target, symlinks=True, ignore=is_ignored, dirs_exist_ok=True)
    else:
        shutil.copy2(source, target)


def _open_to_all(root: Path) -> None:
    """Let every user read what was installed under a umask such as 077: a sandbox has a user of its own."""
    for path in (root, *root.rglob("*")):
        if not path.is_symlink():
            mode = path.stat().st_mode
            path.chmod(mode | (0o555 if path.is_dir() or mode & 0o100 else 0o444))


def _left_out_of_python(_: str, names: list[str]) -> set[str]:
    return {name for name in names if name in _LEFT_OUT_OF_PYTHON or name.startswith("config-") or name.endswith(".a")}


def _copy_system_python(interpreter: Interpreter, root: Path) -> None:
    version = interpreter.executable.resolve().name
    for folder in (Path("/usr/lib", version), Path("/usr/local/lib", version), Path("/usr/lib64", version)):
        if folder.is_dir():
            _copy(folder, root / folder.relative_to("/"), _left_out_of_python)
    _copy_below_usr(interpreter.executable, root)


def _copy_below_usr(file: Path, root: Path) -> Path:
    """Copy what a path leads to, under that name; folders such as /lib are links into /usr."""
    target = root / (file.parent.resolve() / file.name).relative_to("/")
    if not target.exists():
        _copy(file.resolve(), target)
    return target


def _copy_libraries(root: Path) -> None:
    """Copy the libraries of the system that anything in the folder is linked with."""
    programs = [path for path in root.rglob("*") if _is_program(path)]
    needed = set(map(Path, _linked(programs)))
    folders = {library.parent for library in needed if library.name.startswith("libc.so")}
    needed |= {folder / name for folder in folders for name in _LIBRARIES if (folder / name).exists()}
    for library in sorted(needed):
        if not library.is_relative_to(root):
            _copy_below_usr(library, root)


def _is_program(path: Path) -> bool:
    if path.is_symlink() or not path.is_file() or not (".so" in path.name or os.access(path, os.X_OK)):
        return False
    with path.open("rb") as file:
        return file.read(4) == b"\x7fELF"


def _linked(programs: Iterable[Path]) -> set[str]:
    """Return what the dynamic loader finds for these programs and libraries, all of which are ours."""
    listed = subprocess.run(  # noqa: S603 - asks the loader about our own files
        ["/usr/bin/ldd", *map(str, programs)], capture_output=True, text=True, check=False
    ).stdout
    return set(re.findall(r"^\s+(?:\S+ => )?(/\S+) \(0x", listed, re.MULTILINE))


def _file_system(folder: Path) -> str | None:
    """Return the kind of file system that a folder is on; None where there is no such folder."""
    if not folder.is_dir():
        return None
    place, innermost = "", None
    for line in Path("/proc/self/mounts").read_text().splitlines():
        _, mounted, kind, *_ = line.split(" ")
        if folder.resolve().is_relative_to(mounted) and len(mounted) >= len(place):
            place, innermost = mounted, kind
    return innermost


_COPY_SUBMISSION: Final = """
/bin/mount -t tmpfs -o mode=0755,nosuid,nodev,size="$1" vitac "$2" &&
/bin/cp -RP --preserve=mode,timestamps "$3/." "$2/" &&
shift 3 && exec "$@"
"""
"""A shell that mounts a tmpfs which nobody else sees, copies the submission into it, and becomes what follows."""


def with_submission_in_memory(command: list[str], *, submission: Path, root: Path, size_bytes: int) -> list[str]:
    """Return the command line that runs another one while the submission lies in a tmpfs of its own."""
    private = ["--mount", "--propagation", "private"]
    if os.geteuid() != 0:
        private += ["--user", "--map-root-user"]
    arguments = [str(size_bytes + _MARGIN_BYTES), str(mount_point(root)), str(submission.resolve())]
    return ["/usr/bin/unshare", *private, "/bin/sh", "-c", _COPY_SUBMISSION, "sh", *arguments, *command]


def mount_point(root: Path) -> Path:
    """Return where the submission is mounted, in the sandbox's own namespace alone."""
    return root.parent / "submission"
