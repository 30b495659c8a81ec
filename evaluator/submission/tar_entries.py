"""Reads a tar as a stream, entry by entry, in bounded memory and with nothing written; called by `image` and `layers`.

`tarfile` reads a header of any size into memory and seeks backwards, which a layer that is unpacked as it comes cannot.
"""

import tarfile
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Final

from .names import ArchiveFault, ArchiveRejected

_BLOCK_BYTES: Final = 512
_CHUNK_BYTES: Final = 1 << 20
_HEADER_BYTES: Final = 1 << 20
"""Largest long name or extended header."""
_FILES: Final = (tarfile.REGTYPE, tarfile.AREGTYPE, tarfile.CONTTYPE)
_ENDS: Final = bytes(_BLOCK_BYTES)


class EntryType(StrEnum):
    """What an entry of a tar is."""

    FILE = "file"
    FOLDER = "folder"
    SYMLINK = "symbolic link"
    HARD_LINK = "hard link"
    SPECIAL = "device, pipe or sparse file"


_TYPES: Final = {
    **dict.fromkeys(_FILES, EntryType.FILE),
    tarfile.DIRTYPE: EntryType.FOLDER,
    tarfile.SYMTYPE: EntryType.SYMLINK,
    tarfile.LNKTYPE: EntryType.HARD_LINK,
}

Read = Callable[[int], bytes]
"""Returns the next bytes, fewer than asked for only at the end."""


@dataclass(frozen=True, kw_only=True)
class TarEntry:
    """One entry; its content is read before the next one is asked for, or passed over.

    Attributes:
        path: as the tar has it.
        type: what it is.
        link: where a link leads, as the tar has it.
        mode: permissions.
        modified_s: time of the last change [s], whole.
        n_bytes: length of the content.
        chunks: yields the content.
    """

    path: str
    type: EntryType
    link: str
    mode: int
    modified_s: int
    n_bytes: int
    chunks: Callable[[], Iterator[bytes]]


def read_tar(read: Read, what: str) -> Iterator[TarEntry]:
    """Yield the entries of a tar, the extended headers taken into account.

    Args:
        read: gives its bytes.
        what: names it in messages.

    Raises:
        ArchiveRejected: it is damaged.
    """
    extended: dict[str, str] = {}
    while (block := read(_BLOCK_BYTES)) and block != _ENDS:
        header = _parse_header(block, what)
        size = _number(extended.get("size", str(header.size)), what)
        if size < 0:
            raise damaged(what, f"a file has the size {size}")
        if header.type in {tarfile.GNUTYPE_LONGNAME, tarfile.GNUTYPE_LONGLINK}:
            key = "path" if header.type == tarfile.GNUTYPE_LONGNAME else "linkpath"
            extended[key] = _read_header(read, header.size, what).rstrip(b"\0").decode("utf-8", "surrogateescape")
            continue
        if header.type in {tarfile.XHDTYPE, tarfile.SOLARIS_XHDTYPE, tarfile.XGLTYPE}:
            records = dict(_parse_records(_read_header(read, header.size, what), what))
            extended |= records if header.type != tarfile.XGLTYPE else {}
            continue
        content = _Content(read, size if header.type in _FILES else 0, what)
        yield TarEntry(
            path=extended.get("path", header.name),
            type=_type_of(header, extended),
            link=extended.get("linkpath", header.linkname),
            mode=header.mode,
            modified_s=_number(extended.get("mtime", str(header.mtime)).partition(".")[0], what),
            n_bytes=content.left,
            chunks=content.chunks,
        )
        content.pass_over()
        extended = {}


def damaged(what: str, how: str) -> ArchiveRejected:
    """Return the rejection of a file that is not what it should be."""
    return ArchiveRejected(ArchiveFault.DAMAGED, f"{what} is damaged: {how}. Save the image and upload it again.")


class _Content:
    """The content of one entry."""

    def __init__(self, read: Read, n_bytes: int, what: str) -> None:
        self._read = read
        self._what = what
        self._padding = -n_bytes % _BLOCK_BYTES
        self.left = n_bytes

    def chunks(self) -> Iterator[bytes]:
        """Yield what is left of it."""
        while self.left:
            chunk = self._read(min(self.left, _CHUNK_BYTES))
            if not chunk:
                raise damaged(self._what, "it ends in the middle of a file")
            self.left -= len(chunk)
            yield chunk

    def pass_over(self) -> None:
        """Go on to the next header."""
        for _ in self.chunks():
            pass
        if len(self._read(self._padding)) < self._padding:
            raise damaged(self._what, "it ends in the middle of a file")


def _parse_header(block: bytes, what: str) -> tarfile.TarInfo:
    try:
        return tarfile.TarInfo.frombuf(block, "utf-8", "surrogateescape")
    except (tarfile.HeaderError, ValueError) as error:
        raise damaged(what, f"a header cannot be read ({error})") from error


def _type_of(header: tarfile.TarInfo, extended: Mapping[str, str]) -> EntryType:
    if any(key.startswith("GNU.sparse") for key in extended):
        return EntryType.SPECIAL
    return _TYPES.get(header.type, EntryType.SPECIAL)


def _read_header(read: Read, n_bytes: int, what: str) -> bytes:
    if n_bytes > _HEADER_BYTES:
        raise damaged(what, f"a header has {n_bytes} bytes, expected at most {_HEADER_BYTES}")
    data = read(n_bytes + -n_bytes % _BLOCK_BYTES)
    if len(data) < n_bytes:
        raise damaged(what, "it ends in the middle of a header")
    return data[:n_bytes]


def _parse_records(data: bytes, what: str) -> Iterator[tuple[str, str]]:
    """Yield keyword and value of the records of an extended header, each `LENGTH KEYWORD=VALUE` and a new line."""
    while data:
        digits, _, _ = data.partition(b" ")
        length = int(digits) if digits.isdigit() and len(digits) < 8 else 0
        keyword, is_there, value = data[len(digits) + 1 : length].partition(b"=")
        if not is_there or not value.endswith(b"\n"):
            raise damaged(what, "an extended header cannot be read")
        yield keyword.decode("utf-8", "replace"), value[:-1].decode("utf-8", "surrogateescape")
        data = data[length:]


def _number(text: str, what: str) -> int:
    try:
        value = int(text)
    except ValueError:
        value = 1 << 62
    if value.bit_length() > 62:
        raise damaged(what, f"a header has {text!r:.40}, expected a number of 62 bits")
    return value
