"""Packs a submission's folder into an archive: the same bytes for the same files on every machine.

Called by `submit` and `demo`. The evaluator decides which files are ignored.
"""

import shutil
import zipfile
import zlib
from collections.abc import Iterator
from pathlib import Path

FIXED_TIME = (1980, 1, 1, 0, 0, 0)
READABLE_FILE = 0o100644 << 16
UNIX = 3
COPY_BYTES = 1 << 20
SAMPLE_BYTES = 1 << 20
WORTH_COMPRESSING = 0.9
"""A file whose start does not shrink to less of itself is stored as it is: compressing weights takes far longer than
sending them."""


def pack(folder: Path, archive: Path) -> int:
    """Write the archive of a submission's folder, with fixed order, times and modes and without caches.

    Args:
        folder: contains `submission.yaml`, directly or in a folder of its track such as `Track_1`.
        archive: file to write.

    Returns:
        Number of files packed.

    Raises:
        NoSubmission: the folder contains no submission.
        ManifestRejected: its manifest cannot be read.
        ArchiveRejected: the folder contains a link or a device.
    """
    from vitac.evaluator.submission.sources import find_submission, top_folder

    found = find_submission(folder)
    top = top_folder(found)
    paths = sorted(_files(found, ""))
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED, compresslevel=6) as writer:
        for path in paths:
            _add(writer, found / path, f"{top}/{path}")
    return len(paths)


def _add(writer: zipfile.ZipFile, file: Path, path: str) -> None:
    entry = zipfile.ZipInfo(path, FIXED_TIME)
    entry.compress_type = zipfile.ZIP_DEFLATED if _shrinks(file) else zipfile.ZIP_STORED
    entry.create_system = UNIX
    entry.external_attr = READABLE_FILE
    entry.file_size = file.stat().st_size
    with file.open("rb") as source, writer.open(entry, "w") as target:
        shutil.copyfileobj(source, target, COPY_BYTES)


def _shrinks(file: Path) -> bool:
    with file.open("rb") as source:
        sample = source.read(SAMPLE_BYTES)
    return len(zlib.compress(sample, level=1)) < WORTH_COMPRESSING * len(sample)


def _files(folder: Path, prefix: str) -> Iterator[str]:
    from vitac.evaluator.submission.names import is_ignored, link, special_file

    for item in folder.iterdir():
        path = f"{prefix}{item.name}"
        if is_ignored(path):
            continue
        if item.is_symlink():
            raise link(path)
        if item.is_dir():
            yield from _files(item, f"{path}/")
        elif item.is_file():
            yield path
        else:
            raise special_file(path)
