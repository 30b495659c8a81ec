"""Keeps a folder for one process; called where trainings and collections write."""

import os
import platform
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from fcntl import LOCK_EX, LOCK_NB, flock
from pathlib import Path

from vitac.errors import VitacError

from .files import not_saved


class FolderInUse(VitacError):
    """Another process writes in the folder; wait for it, end it, or give another folder."""


@contextmanager
def hold_folder(folder: Path, tell: Callable[[str], None] = lambda _: None) -> Iterator[None]:
    """Keep other processes from writing in a folder, whose files they would mix up.

    The file that is locked names this process. It is never replaced or removed, for another one of its name could be
    locked as well. Processes that this one starts hold it, too, and end with it.

    Args:
        folder: made if it is not there.
        tell: called where the file system has no locks.

    Raises:
        FolderInUse: another process holds it.
        NotSaved: the folder cannot be written.
    """
    path = folder / ".lock"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        file = path.open("a+b")
    except OSError as error:
        raise not_saved(path, error) from error
    with file:
        try:
            flock(file, LOCK_EX | LOCK_NB)
            file.truncate(0)
            file.write(f"process {os.getpid()} on {platform.node()}\n".encode())
            file.flush()
        except BlockingIOError as error:
            holder = path.read_text("utf-8", "replace").strip() or "it does not say which"
            raise FolderInUse(
                f"Another process writes in {folder} ({holder}); wait for it, end it, or give another folder."
            ) from error
        except OSError as error:
            tell(f"{folder} takes no lock ({error.strerror}); make sure that no other process writes there")
        yield
