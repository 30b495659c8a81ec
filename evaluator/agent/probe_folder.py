"""Folders for submissions of our own, which try out the sandbox; used by `self_test` and `description`."""

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

_PREFIX = "vitac-doctor-"


@contextmanager
def probe_folder() -> Iterator[Path]:
    """Return a folder in which all is readable for everybody, and remove it, with what killed processes have left."""
    _remove_leftovers()
    with tempfile.TemporaryDirectory(prefix=f"{_PREFIX}{os.getpid()}-") as name:
        folder = Path(name)
        folder.chmod(0o755)  # Under root the sandbox has its own user, which must be able to read the policy.
        before = os.umask(0o022)
        try:
            yield folder
        finally:
            os.umask(before)


def _remove_leftovers() -> None:
    for folder in Path(tempfile.gettempdir()).glob(f"{_PREFIX}*"):
        pid = folder.name.removeprefix(_PREFIX).partition("-")[0]
        if pid.isdigit() and not Path("/proc", pid).exists():
            shutil.rmtree(folder, ignore_errors=True)
