"""Finds and reads files that somebody else chose; called by the readers of STL, Gmsh, sensor and submission files."""

import os
import stat
from pathlib import Path


def read_start(path: Path, max_bytes: int) -> bytes:
    """Return a file's content, or its first `max_bytes` + 1 bytes where it is larger.

    Args:
        path: untrusted; a pipe or device under this name is never waited for.
        max_bytes: what the caller takes.

    Raises:
        OSError: it cannot be read, or is no regular file; `strerror` says which.
    """
    with open(path, "rb", opener=_open_without_blocking) as file:
        return file.read(max_bytes + 1)


def find_spelling(folder: Path, name: str) -> Path:
    """Return the file of a folder that has this name but for capitals; the path of this very name where none has."""
    others = (path for path in folder.iterdir() if path.name.lower() == name) if folder.is_dir() else iter(())
    return folder / name if (folder / name).exists() else min(others, default=folder / name)


def _open_without_blocking(path: str, flags: int) -> int:
    descriptor = os.open(path, flags | os.O_NONBLOCK | os.O_CLOEXEC)
    mode = os.fstat(descriptor).st_mode
    if stat.S_ISREG(mode):
        return descriptor
    os.close(descriptor)
    raise OSError(0, "It is a folder" if stat.S_ISDIR(mode) else "It is no regular file", path)
