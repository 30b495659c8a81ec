"""Folders for the work of one process in the scratch folder, found again and removed when the process was killed."""

import os
import re
import shutil
import socket
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


def new_folder(scratch_dir: Path, purpose: str) -> Path:
    """Make a private folder that names its process; whoever makes it removes it.

    Args:
        scratch_dir: shared by processes of several machines perhaps.
        purpose: first word of the folder's name.
    """
    scratch_dir.mkdir(mode=0o700, parents=True, exist_ok=True)
    return Path(tempfile.mkdtemp(prefix=f"{purpose}-{socket.gethostname()}-{os.getpid()}-", dir=scratch_dir))


@contextmanager
def scratch_folder(scratch_dir: Path, purpose: str) -> Iterator[Path]:
    """Return such a folder, gone with all it holds when the block is left."""
    folder = new_folder(scratch_dir, purpose)
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def remove_leftovers(scratch_dir: Path) -> None:
    """Remove the folders of processes of this machine that are gone."""
    name = re.compile(rf"[a-z]+-{re.escape(socket.gethostname())}-(\d+)-.+")
    for folder in scratch_dir.iterdir():
        found = name.fullmatch(folder.name)
        if found and not Path("/proc", found[1]).exists():
            shutil.rmtree(folder, ignore_errors=True)
