"""Unpacks an uploaded zip without trusting anything in it; each broken rule has a code and a message.

Called by the upload (to refuse early), by workers and by `vitac check`. A folder goes through the same rules.
"""

import io
import os
import shutil
import stat
import struct
import zipfile
import zlib
from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import IO, BinaryIO, Final

from ..agent.limits import Limits
from ..tracks import archive_folders, load_track
from .manifest import MANIFEST_MAX_BYTES, parse_manifest
from .names import (
    MANIFEST_NAME,
    ArchiveFault,
    ArchiveRejected,
    NamedEntry,
    check_names,
    fixed_name,
    is_ignored,
    link,
    special_file,
    too_many_files,
)

__all__ = [
    "ArchiveEntry",
    "ArchiveFault",
    "ArchiveRejected",
    "packed_entries",
    "packed_files",
    "unpack",
    "unpacked_too_large",
    "write",
]

_CHUNK_BYTES: Final = 1024 * 1024
_FOLDER_MODE: Final = 0o755
"""Set once a folder is made: the umask would cut it."""
_RATIO_FREE_BYTES: Final = 16 * 1024 * 1024
"""A ratio is only looked at above this size: small folders of text compress well."""
_END_RECORD: Final = struct.Struct("<4s4H2LH")
_END_SIGNATURE: Final = b"PK\x05\x06"
_ZIP64_LOCATOR: Final = b"PK\x06\x07"
_ZIP64_LOCATOR_BYTES: Final = 20
_ZIP64_RECORD: Final = struct.Struct("<4sQ2H2L4Q")
_ZIP64_SIGNATURE: Final = b"PK\x06\x06"
_DIRECTORY_BYTES_PER_FILE: Final = 1536
_START_SIGNATURES: Final = (b"PK\x03\x04", _END_SIGNATURE)
_SHOWN_CHARACTERS: Final = 80
_METHODS: Final = frozenset({zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED})
_ENCRYPTED_FLAGS: Final = 0x1 | 0x40 | 0x2000
_UTF_8_FLAG: Final = 0x800


@dataclass(frozen=True, kw_only=True)
class ArchiveEntry:
    """One file of a submission, whatever it comes from."""

    path: str
    """Below the top folder, with slashes."""
    n_bytes: int
    open: Callable[[], IO[bytes]]

    def chunks(self) -> Iterator[bytes]:
        """Yield the content.

        Raises:
            ArchiveRejected: it cannot be read.
        """
        try:
            with self.open() as file:
                while chunk := file.read(_CHUNK_BYTES):
                    yield chunk
        except (zipfile.BadZipFile, zlib.error, EOFError, ValueError, struct.error, NotImplementedError) as error:
            raise _damaged(f"{self.path!r} cannot be unpacked ({error})") from error


def unpack(source: Path | BinaryIO, destination: Path, limits: Limits | None = None) -> Path:
    """Unpack an archive into a new folder; on a rejection nothing of it is left.

    Args:
        source: the zip, or an open one that can seek.
        destination: folder that does not exist yet, or is empty.
        limits: sizes and counts.

    Returns:
        The submission's folder, such as `destination/Track_1`, readable by every user.

    Raises:
        ArchiveRejected: a rule is broken.
        ManifestRejected: the files lie at the top of the archive, and their manifest does not say for which track.
    """
    limits = limits or Limits()
    with ExitStack() as exits:
        stream = exits.enter_context(source.open("rb")) if isinstance(source, Path) else source
        top, entries = exits.enter_context(_Opened(stream, limits)).entries()
        return write(entries, destination, top, limits)


def packed_entries(stream: BinaryIO, limits: Limits, exits: ExitStack) -> tuple[str, list[ArchiveEntry]]:
    """Return top folder and files of an open archive after checking its directory."""
    return exits.enter_context(_Opened(stream, limits)).entries()


def packed_files(stream: BinaryIO, limits: Limits, exits: ExitStack) -> list[ArchiveEntry]:
    """Return all files of any open zip, such as a wheel, after checking its directory."""
    return exits.enter_context(_Opened(stream, limits)).files()


def write(entries: Iterable[ArchiveEntry], destination: Path, top: str, limits: Limits) -> Path:
    """Write files below `destination/top`, counting real bytes.

    Raises:
        ArchiveRejected: a file holds more or less than it says, or all together hold too much.
    """
    folder = destination / top
    try:
        destination.mkdir(mode=0o755, parents=True, exist_ok=True)
        folder.mkdir()
        folder.chmod(_FOLDER_MODE)
        left = limits.archive_unpacked_bytes
        for entry in entries:
            left -= _write_entry(entry, folder, left, limits)
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise
    return folder


class _Opened:
    """An archive whose directory has been checked."""

    def __init__(self, stream: BinaryIO, limits: Limits) -> None:
        self._limits = limits
        self._packed_bytes = _check_ends(stream, limits)
        try:
            self._zip = zipfile.ZipFile(stream)
        except (zipfile.BadZipFile, ValueError, OSError, struct.error, NotImplementedError) as error:
            raise _damaged(f"its directory cannot be read ({error})") from error

    def __enter__(self) -> "_Opened":
        return self

    def __exit__(self, *exception: object) -> None:
        self._zip.close()

    def entries(self) -> tuple[str, list[ArchiveEntry]]:
        """Return the top folder and the files below it.

        Raises:
            ArchiveRejected: a rule is broken by what the directory says.
        """
        kept, files = self._checked()
        manifests = [name for name in files if fixed_name(name) == MANIFEST_NAME]
        if manifests and not {name.partition("/")[0] for name, _ in kept} & set(archive_folders()):
            top, prefix = self._track_folder(files[manifests[0]]), ""
        else:
            top = _top_folder({name for name, _ in kept if not _is_beside(name)})
            prefix = f"{top}/"
        inside = [(name.removeprefix(prefix), info) for name, info in files.items() if name.startswith(prefix)]
        return top, [self._entry(info, fixed_name(path)) for path, info in inside]

    def files(self) -> list[ArchiveEntry]:
        """Return the files, whatever their folders.

        Raises:
            ArchiveRejected: a rule is broken by what the directory says.
        """
        return [self._entry(info, name) for name, info in self._checked()[1].items()]

    def _checked(self) -> tuple[list[tuple[str, zipfile.ZipInfo]], dict[str, zipfile.ZipInfo]]:
        """Return all entries with their paths, and the files by path."""
        infos = self._zip.infolist()
        if len(infos) > self._limits.archive_files:
            raise too_many_files(self._limits)
        for info in infos:
            _check_file_type(info)
        kept = [(name, info) for name, info in zip(map(_name, infos), infos, strict=True) if not is_ignored(name)]
        check_names((NamedEntry(path=name, is_folder=_is_folder(info)) for name, info in kept), self._limits)
        files = {name: info for name, info in kept if not _is_folder(info)}
        self._check_sizes([*files.values()])
        return kept, files

    def _track_folder(self, manifest: zipfile.ZipInfo) -> str:
        """Return the folder of the track that a manifest at the top of the archive names.

        Raises:
            ManifestRejected: it cannot be read, or names no track.
        """
        entry = self._entry(manifest, MANIFEST_NAME)
        content = b"".join(entry.chunks()) if entry.n_bytes <= MANIFEST_MAX_BYTES else b" " * (MANIFEST_MAX_BYTES + 1)
        return load_track(parse_manifest(content).track).folder

    def _check_sizes(self, files: list[zipfile.ZipInfo]) -> None:
        total = sum(info.file_size for info in files)
        if total > self._limits.archive_unpacked_bytes:
            raise unpacked_too_large(self._limits)
        if total > max(_RATIO_FREE_BYTES, self._packed_bytes * self._limits.archive_ratio):
            raise ArchiveRejected(
                ArchiveFault.COMPRESSED_TOO_MUCH,
                f"The archive of {self._packed_bytes} bytes unpacks to {total}, more than "
                f"{self._limits.archive_ratio:g} times as much; leave out what compresses like that.",
            )

    def _entry(self, info: zipfile.ZipInfo, path: str) -> ArchiveEntry:
        def open_entry() -> IO[bytes]:
            try:
                return self._zip.open(info)
            except (zipfile.BadZipFile, ValueError, OSError, struct.error, NotImplementedError, RuntimeError) as error:
                raise _damaged(f"{info.filename!r} cannot be read ({error})") from error

        return ArchiveEntry(path=path, n_bytes=info.file_size, open=open_entry)


def _check_ends(stream: BinaryIO, limits: Limits) -> int:
    """Look at the start and the end record before `zipfile` reads a directory of any size into memory."""
    packed_bytes = stream.seek(0, io.SEEK_END)
    if packed_bytes > limits.archive_packed_bytes:
        raise ArchiveRejected(
            ArchiveFault.TOO_LARGE,
            f"The archive has {packed_bytes} bytes, expected at most {limits.archive_packed_bytes}.",
        )
    stream.seek(0)
    if stream.read(4) not in _START_SIGNATURES:
        raise ArchiveRejected(ArchiveFault.NOT_A_ZIP, "The file is not a zip archive; pack the folder as a zip.")
    ends_bytes = _ZIP64_RECORD.size + _ZIP64_LOCATOR_BYTES + _END_RECORD.size
    tail_start = max(0, packed_bytes - 0xFFFF - ends_bytes)
    stream.seek(tail_start)
    tail = stream.read()
    position = tail.rfind(_END_SIGNATURE)
    if position < 0 or len(tail) - position < _END_RECORD.size:
        raise _damaged("its end record is missing; the upload may be truncated")
    *_, entries, directory_bytes, _, _ = _END_RECORD.unpack_from(tail, position)
    locator = position - _ZIP64_LOCATOR_BYTES
    if tail[max(0, locator) :].startswith(_ZIP64_LOCATOR):
        start = locator - _ZIP64_RECORD.size
        if start < 0 or not tail[start:].startswith(_ZIP64_SIGNATURE):
            raise _damaged("its end record for large archives (zip64) is missing")
        *_, entries, directory_bytes, _ = _ZIP64_RECORD.unpack_from(tail, start)
    if directory_bytes > limits.archive_files * _DIRECTORY_BYTES_PER_FILE or entries > limits.archive_files:
        raise too_many_files(limits)
    return packed_bytes


def _name(info: zipfile.ZipInfo) -> str:
    """Return the path of an entry, without a slash at its end.

    Names without the flag for UTF-8 are in it all the same, as macOS writes them, or in an encoding that is not said.
    """
    name = info.orig_filename.removesuffix("/")
    if name.isascii() or info.flag_bits & _UTF_8_FLAG:
        return name
    try:
        return name.encode("cp437").decode("utf-8")
    except UnicodeError:
        raise ArchiveRejected(
            ArchiveFault.BAD_CHARACTERS,
            f"{name!r:.200} is not in UTF-8: the program that packed it used another encoding, such as GBK. Rename the "
            "file with ASCII letters, or pack with `python -m zipfile -c mine.zip FOLDER`.",
        ) from None


def _is_beside(path: str) -> bool:
    """Return whether a path at the top says what the archive is, beside the submission's folder."""
    return "/" not in path and path.lower().partition(".")[0] in {"readme", "license"}


def _is_folder(info: zipfile.ZipInfo) -> bool:
    # `is_dir` looks at the name up to its first NUL and crashes where that leaves nothing.
    return info.orig_filename.endswith("/")


def _check_file_type(info: zipfile.ZipInfo) -> None:
    mode = info.external_attr >> 16
    name = info.orig_filename
    if stat.S_ISLNK(mode):
        raise link(name)
    if stat.S_IFMT(mode) not in {0, stat.S_IFREG, stat.S_IFDIR}:
        raise special_file(name)
    if info.flag_bits & _ENCRYPTED_FLAGS:
        raise ArchiveRejected(ArchiveFault.ENCRYPTED, f"{name!r} is encrypted; pack without a password.")
    if info.compress_type not in _METHODS:
        raise ArchiveRejected(
            ArchiveFault.COMPRESSION_METHOD,
            f"{name!r} is compressed with method {info.compress_type}; pack with deflate or without compression.",
        )


def _top_folder(paths: set[str]) -> str:
    """Return the one folder that all paths are in, which has to be a track's."""
    allowed = archive_folders()
    names = {path.partition("/")[0] for path in paths}
    if len(names) == 1 and (name := names.copy().pop()) in allowed:
        return name
    tops = ", ".join(repr(name)[:_SHOWN_CHARACTERS] for name in sorted(names)[:5]) or "nothing"
    raise ArchiveRejected(
        ArchiveFault.WRONG_TOP_FOLDER,
        f"The archive holds {tops}, expected one folder {' or '.join(allowed)}{_mend(paths, names, allowed)}.",
    )


def _mend(paths: set[str], names: set[str], allowed: Collection[str]) -> str:
    """Return what to do about a folder with another name, and about one too many."""
    top = next(iter(names), "")
    if len(names) != 1 or "/" in top:
        return ""
    inner = {path.split("/")[1] for path in paths if "/" in path}
    if MANIFEST_NAME in inner:
        return "; rename that folder"
    return f"; pack {min(inner & set(allowed))} itself, without the folder around it" if inner & set(allowed) else ""


def _write_entry(entry: ArchiveEntry, folder: Path, left: int, limits: Limits) -> int:
    target = folder / entry.path
    for parent in reversed(target.relative_to(folder).parents[:-1]):
        (folder / parent).mkdir(exist_ok=True)
        (folder / parent).chmod(_FOLDER_MODE)
    flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW
    written = 0
    with os.fdopen(os.open(target, flags, 0o644), "wb") as file:
        for chunk in entry.chunks():
            written += len(chunk)
            if written > left:
                raise unpacked_too_large(limits)
            file.write(chunk)
    target.chmod(0o644)
    if written != entry.n_bytes:
        raise _damaged(f"{entry.path!r} has {written} bytes, expected {entry.n_bytes}")
    return written


def _damaged(what: str) -> ArchiveRejected:
    return ArchiveRejected(ArchiveFault.DAMAGED, f"The archive is damaged: {what}. Pack and upload it again.")


def unpacked_too_large(limits: Limits) -> ArchiveRejected:
    """Return the rejection of files that are too large together."""
    return ArchiveRejected(
        ArchiveFault.UNPACKED_TOO_LARGE, f"The files are larger than {limits.archive_unpacked_bytes} bytes together."
    )
