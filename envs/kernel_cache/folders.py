"""Where compiled kernels are stored, and when unused ones are removed."""

import logging
import os
import shutil
import tempfile
import time
from contextlib import suppress
from functools import cache
from pathlib import Path

from ..errors import VitacError

_LOG = logging.getLogger("vitac.envs.compilation")
_NAME = "kernels"
# A folder that no process has read or written for this time [s] is removed.
_UNUSED_S = 30 * 86400.0
# A folder's time of use is written at most so often [s].
_USE_NOTED_S = 86400.0


class CacheNotWritable(VitacError):
    """Compiled kernels cannot be stored in the folder for them; the message names it. Set `VITAC_CACHE_DIR`."""


@cache
def cache_directory() -> Path:
    """Return the folder of compiled kernels: the one that processes share, else a private temporary one.

    A shared folder that `vitac compile` has filled is only read where it cannot be written to.
    """
    if shared := shared_directory() or _read_only_directory():
        return shared
    _LOG.warning(
        "Compiled kernels cannot be stored in %s: every process compiles for itself, for half a minute. Name a folder "
        "that can be written to in VITAC_CACHE_DIR, or fill it once with `vitac compile`.",
        cache_root(),
    )
    return _private_directory()


def shared_directory() -> Path | None:
    """Return the folder in `VITAC_CACHE_DIR` or the user's cache folder; None where it cannot be written to."""
    directory = cache_root() / _NAME
    try:
        directory.mkdir(parents=True, exist_ok=True)
    except OSError:
        return None
    return directory if os.access(directory, os.W_OK) else None


def note_use(folder: Path) -> None:
    """Set the time of use of a module's folder, where it is long ago and the folder is ours."""
    with suppress(OSError):  # another process has removed it, or another user owns it
        if time.time() - folder.stat().st_mtime > _USE_NOTED_S:
            os.utime(folder)


def remove_unused(directory: Path) -> None:
    """Remove what has not been used for 30 days: modules' folders, and caches of earlier versions beside them."""
    folders = [path for path in directory.iterdir() if path.is_dir()]
    folders += [path for path in directory.parent.glob(f"{_NAME}-*") if path.is_dir()]
    for folder in folders:
        try:
            unused = time.time() - folder.stat().st_mtime > _UNUSED_S
        except FileNotFoundError:  # another process has removed it
            continue
        if unused:
            shutil.rmtree(folder, ignore_errors=True)


def cache_root() -> Path:
    """Return the folder of all that is stored between runs: `VITAC_CACHE_DIR`, else in the user's cache folder."""
    if explicit := os.environ.get("VITAC_CACHE_DIR"):
        return Path(explicit)
    home_cache = os.environ.get("XDG_CACHE_HOME")
    return (Path(home_cache) if home_cache else Path.home() / ".cache") / "vitac"


def _read_only_directory() -> Path | None:
    """Return the shared folder if it holds compiled kernels."""
    directory = cache_root() / _NAME
    return directory if next(directory.glob("*/*.nbi"), None) else None


def _private_directory() -> Path:
    directory = Path(tempfile.mkdtemp(prefix="vitac-")) / _NAME
    directory.mkdir()
    return directory
