"""Folders for the work of one process in the scratch folder, found again and removed when the process was killed."""

import fcntl
import os
import re
import shutil
import socket
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path


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
