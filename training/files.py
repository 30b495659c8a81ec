"""Files of a training run: written whole or not at all, with a digest in them by which damage is found."""

import errno
import hashlib
import os
import re
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, BinaryIO
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray
from vitac.errors import VitacError

Arrays = dict[str, NDArray[Any]]

_DIGEST = "digest"
_DISK_FULL = {errno.ENOSPC, errno.EDQUOT}
_LEFTOVER = re.compile(r"\..+\.(?P<process>[0-9]+)\.new")
"""Name of a file that is not whole yet."""


class FileDamaged(VitacError):
    """A file of a training run does not hold what was written; delete it, and the run makes it again."""


class NotSaved(VitacError):
    """A file of a training run could not be written, such as on a full disk; what was saved before is kept."""


def save(path: Path, arrays: Mapping[str, NDArray[Any]]) -> None:
    """Write arrays, replacing the file only when all is on the disk.

    Raises:
        NotSaved: it cannot be written.
    """
    with _replacing(path) as file:
        np.savez(file, **arrays, **{_DIGEST: np.array(digest(arrays))})  # type: ignore[arg-type]


def write_text(path: Path, text: str) -> None:
    """Write text, see `write_bytes`."""
    write_bytes(path, text.encode())


def write_bytes(path: Path, data: bytes) -> None:
    """Write a file, replacing one that is there only when all is on the disk.

    Raises:
        NotSaved: it cannot be written.
    """
    with _replacing(path) as file:
        file.write(data)


@contextmanager
def _replacing(path: Path) -> Iterator[BinaryIO]:
    new = path.with_name(f".{path.name}.{os.getpid()}.new")  # `_LEFTOVER` finds it
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with new.open("wb") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        new.replace(path)
    except OSError as error:
        raise not_saved(path, error) from error
    finally:
        with suppress(OSError):
            new.unlink(missing_ok=True)  # also after Ctrl-C


def not_saved(path: Path, error: OSError) -> NotSaved:
    """Return what to raise where a file or folder cannot be written: with what to do about it."""
    remedy = "free some space and run it again" if error.errno in _DISK_FULL else "give a folder that can be written"
    return NotSaved(f"{path} cannot be written ({error.strerror}); {remedy}.")


def remove_leftovers(folder: Path) -> None:
    """Remove the files in a folder that processes which are no more left half written."""
    for path in folder.glob(".*.new"):
        named = _LEFTOVER.fullmatch(path.name)
        if named and not _is_another_running(int(named["process"])):
            with suppress(OSError):
                path.unlink()


def _is_another_running(process: int) -> bool:
    if process == os.getpid():  # in a container, also that of the run before
        return False
    try:
        os.kill(process, 0)
    except PermissionError:
        return True
    except (ProcessLookupError, OverflowError):
        return False
    return True


def load(path: Path) -> Arrays:
    """Read arrays that `save` wrote.

    Raises:
        FileDamaged: the file is not what was written.
    """
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as stored:
            arrays = {name: stored[name] for name in stored.files}
    except (OSError, ValueError, EOFError, KeyError, BadZipFile, zlib.error) as error:
        raise FileDamaged(f"{path} cannot be read ({error}); delete it and run it again.") from error
    stored = arrays.pop(_DIGEST, None)
    if stored is None or str(stored) != digest(arrays):
        raise FileDamaged(f"{path} does not hold what was written; delete it and run it again.")
    return arrays


def digest(arrays: Mapping[str, NDArray[Any]]) -> str:
    """Return the SHA-256 [hex] of arrays with their names, types and shapes."""
    hasher = hashlib.sha256()
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        hasher.update(f"{name} {array.dtype.str} {array.shape}\n".encode())
        hasher.update(array.tobytes())
    return hasher.hexdigest()
