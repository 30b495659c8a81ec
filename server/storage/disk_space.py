"""Tells a full disk from other failures. Called by the API, the file store and the workers."""

import errno
import os
import re
from pathlib import Path
from urllib.parse import unquote, urlsplit

from sqlalchemy.exc import DBAPIError

from ..errors import storage_full
from ..settings import Settings

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
    found = _IN_TEXT.search(str(error))
    if found is not None and int(found[1]) in _ERRORS:
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
