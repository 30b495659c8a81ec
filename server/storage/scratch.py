"""Folders for the work of one process in the scratch folder, found again and removed when the process was killed."""

import os
import shutil
import socket
import tempfile
from pathlib import Path


def new_folder(scratch_dir: Path, purpose: str) -> Path:
    """Make a private folder that names its process; whoever makes it removes it.

    Args:
        scratch_dir: shared by processes of several machines perhaps.
        purpose: first word of the folder's name.
    """
    scratch_dir.mkdir(mode=0o700, parents=True, exist_ok=True)
    return Path(tempfile.mkdtemp(prefix=f"{_prefix(purpose)}{os.getpid()}-", dir=scratch_dir))


def remove_leftovers(scratch_dir: Path, purpose: str) -> None:
    """Remove the folders of processes of this machine that are gone."""
    prefix = _prefix(purpose)
    for folder in scratch_dir.glob(f"{prefix}*"):
        number = folder.name.removeprefix(prefix).partition("-")[0]
        if number.isdigit() and not Path(f"/proc/{number}").exists():
            shutil.rmtree(folder, ignore_errors=True)


def _prefix(purpose: str) -> str:
    return f"{purpose}-{socket.gethostname()}-"
