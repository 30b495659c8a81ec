"""Folders for the work of one process in the scratch folder, found again and removed when the process was killed."""

import errno
import fcntl
import os
import random
import re
import shutil
import socket
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from urllib.parse import unquote, urlsplit

from sqlalchemy.exc import DBAPIError

from ..errors import storage_full
from ..settings import Settings

_PAUSE_S = 0.02


@contextmanager
def scratch_folder(scratch_dir: Path, purpose: str) -> Iterator[Path]:
    """Return a new private folder, gone with all it holds when the block is left.

    A lock shows others that it is in use; the kernel takes it back when the process ends, however that happens. Where
    the file system has no locks for folders, those of killed processes stay.

    Args:
        scratch_dir: shared by processes of several machines perhaps.
        purpose: first word of the folder's name.
    """
    scratch_dir.mkdir(mode=0o700, parents=True, exist_ok=True)
    folder, descriptor = _new_folder(scratch_dir, f"{purpose}-{socket.gethostname()}-")
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)
        os.close(descriptor)


def remove_leftovers(scratch_dir: Path) -> None:
    """Remove the folders of processes of this machine that are gone."""
    name = re.compile(rf"[a-z]+-{re.escape(socket.gethostname())}-[^-]+")
    folders = scratch_dir.iterdir() if scratch_dir.is_dir() else ()
    for folder in folders:
        if name.fullmatch(folder.name):
            with suppress(OSError):  # it is in use, has just been removed, or cannot be locked
                descriptor = _opened(folder)
                try:
                    _lock(descriptor)
                    shutil.rmtree(folder, ignore_errors=True)
                finally:
                    os.close(descriptor)


_COMPLETE, _CONTENT = "complete", "content"
"""What a shared folder holds: a file that says that all is there, and what it is for."""


@contextmanager
def shared_folder(parent: Path, name: str, fill: Callable[[Path], object]) -> Iterator[Path]:
    """Return a folder that processes of this machine share: the first one fills it, the last one removes it.

    What killed processes leave, the next one uses, or `remove_unused` removes.

    Args:
        parent: of the folders of this user.
        name: of what is in it; under one name there is always the same.
        fill: puts that into a new folder.

    Raises:
        PermissionError: the parent belongs to somebody else.
    """
    parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    if parent.lstat().st_uid != os.geteuid():
        raise PermissionError(errno.EPERM, "belongs to somebody else", str(parent))
    descriptor = _share(parent / name, fill)
    try:
        yield parent / name / _CONTENT
    finally:
        _remove_if_unused(parent / name, descriptor)


def remove_unused(parent: Path) -> None:
    """Remove the shared folders that no process uses."""
    for folder in parent.iterdir() if parent.is_dir() else ():
        with suppress(OSError):  # it has just been removed
            _remove_if_unused(folder, _opened(folder))


def _share(folder: Path, fill: Callable[[Path], object]) -> int:
    """Return the locked descriptor of a folder that is complete."""
    while True:
        folder.mkdir(mode=0o755, exist_ok=True)
        try:
            descriptor = _opened(folder)
        except FileNotFoundError:
            continue
        try:
            fcntl.flock(descriptor, fcntl.LOCK_SH)
            if _is_there(folder, descriptor) and (folder / _COMPLETE).exists():
                return descriptor
            # Whoever waited for this lock would wait for all who use what another one fills in between.
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                pass
            else:
                if _is_there(folder, descriptor) and not (folder / _COMPLETE).exists():
                    _fill(folder, fill)
        except BaseException:
            os.close(descriptor)
            raise
        os.close(descriptor)  # a lock that becomes a weaker one is given up in between: look again
        time.sleep(random.uniform(0, _PAUSE_S))  # noqa: S311 - of two who want to fill each may have stopped the other


def _fill(folder: Path, fill: Callable[[Path], object]) -> None:
    """Fill a folder that nobody else uses; after an error nothing is left of it."""
    try:
        shutil.rmtree(folder / _CONTENT, ignore_errors=True)
        (folder / _CONTENT).mkdir(mode=0o755)
        fill(folder / _CONTENT)
        (folder / _COMPLETE).touch()
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise


def _is_there(folder: Path, descriptor: int) -> bool:
    """Return whether a folder is still the one that was opened."""
    with suppress(FileNotFoundError):
        return os.path.samestat(folder.stat(), os.fstat(descriptor))
    return False


def _remove_if_unused(folder: Path, descriptor: int) -> None:
    try:
        with suppress(BlockingIOError):
            _lock(descriptor)
            shutil.rmtree(folder, ignore_errors=True)
    finally:
        os.close(descriptor)


def _new_folder(scratch_dir: Path, prefix: str) -> tuple[Path, int]:
    """Make a folder and lock it; another one if somebody who looked for leftovers was faster."""
    while True:
        folder = Path(tempfile.mkdtemp(prefix=prefix, dir=scratch_dir))
        try:
            descriptor = _opened(folder)
        except FileNotFoundError:
            continue
        try:
            _lock(descriptor)
        except BlockingIOError:
            os.close(descriptor)
            continue
        except OSError:  # no locks here: nobody else can lock it either, and then leaves it alone
            return folder, descriptor
        if folder.is_dir():
            return folder, descriptor
        os.close(descriptor)


def _opened(folder: Path) -> int:
    return os.open(folder, os.O_RDONLY | os.O_DIRECTORY)


def _lock(descriptor: int) -> None:
    fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)


NEEDED_BYTES = 1 << 20
"""Free space below which a disk counts as full."""

RESERVED_BYTES = 4 << 30
RESERVED_SHARE = 0.05
"""What uploads leave free: of a small disk this share."""

_ERRORS = frozenset({errno.ENOSPC, errno.EDQUOT})
_IN_TEXT = re.compile(r"\(os error (\d+)\)")  # the file store passes the system's error on as text only
_SQLSTATE = "53100"


def is_disk_full(error: BaseException) -> bool:
    """Return whether an error, or what caused it, is a lack of disk space; of files, the store or the database."""
    if isinstance(error, OSError) and error.errno in _ERRORS:
        return True
    if isinstance(error, DBAPIError):
        return getattr(error.orig, "sqlstate", None) == _SQLSTATE
    match = _IN_TEXT.search(str(error))
    if match is not None and int(match[1]) in _ERRORS:
        return True
    return error.__cause__ is not None and is_disk_full(error.__cause__)


def require_room(settings: Settings, n_bytes: int) -> None:
    """Refuse an upload that would leave the others without disk space: database, workers, organizers.

    Raises:
        ServiceError: the disk of the state directory, or of the folder where uploads are stored, has too little.
    """
    storage = urlsplit(settings.storage_url or "")
    folders = [settings.state_dir, *([Path(unquote(storage.path))] if storage.scheme == "file" else [])]
    for disk in map(os.statvfs, folders):
        reserve_bytes = min(RESERVED_BYTES, RESERVED_SHARE * disk.f_blocks * disk.f_frsize)
        if disk.f_bavail * disk.f_frsize < n_bytes + reserve_bytes:
            raise storage_full()


def has_space(folder: Path) -> bool:
    """Return whether the disk of a folder, which exists, has room for anything."""
    disk = os.statvfs(folder)
    return disk.f_bavail * disk.f_frsize >= NEEDED_BYTES


@contextmanager
def new_file(path: Path) -> Iterator[Path]:
    """Give a path to write to, in a folder of its own beside the file; after an error nothing is left.

    Args:
        path: which the file gets at the end.

    Raises:
        FileExistsError: there is one, or has been meanwhile wherever hard links work.
        OSError: the folder cannot be written.
    """
    if path.exists():
        raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), str(path))
    with tempfile.TemporaryDirectory(prefix=f"{path.name}.", dir=path.absolute().parent) as folder:
        unfinished = Path(folder) / "unfinished"
        yield unfinished
        try:
            path.hardlink_to(unfinished)
        except OSError as error:
            if error.errno not in {errno.EPERM, errno.EOPNOTSUPP, errno.ENOSYS}:
                raise
            unfinished.rename(path)
