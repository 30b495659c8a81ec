"""A file that gets its name when it is whole, and never takes one that is in use."""

import errno
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


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
