"""Layers of a container image: their entries, checked one by one, and the files that they make together."""

import os
import tarfile
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum
from itertools import count
from pathlib import Path
from typing import Final

from ..agent.isolation.gpu import MOUNT_POINTS
from ..agent.limits import Limits
from .names import ArchiveFault, ArchiveRejected, link, special_file

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
            type=_find_type(header, extended),
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


def _find_type(header: tarfile.TarInfo, extended: Mapping[str, str]) -> EntryType:
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


_WHITEOUT: Final = ".wh."
_OPAQUE: Final = ".wh..wh..opq"
_NOTES: Final = ".wh..wh."
"""How names of the storage's own notes begin."""
_LINKS_FOLLOWED: Final = 40
_PATH_BYTES: Final = 3000
_NAME_BYTES: Final = 255
_DEPTH: Final = 100
_LATEST_S: Final = 1 << 32


@dataclass(frozen=True, kw_only=True)
class _File:
    number: int
    """Of its content; hard links share it."""
    layer: int


@dataclass(frozen=True, kw_only=True)
class _Link:
    target: str
    layer: int


@dataclass(kw_only=True)
class _Folder:
    layer: int
    depth: int = 0
    path_bytes: int = 0
    children: "dict[str, _Node]" = field(default_factory=dict)


_Node = _File | _Link | _Folder


class ImageFiles:
    """The files of an image, layer upon layer.

    Args:
        contents: empty folder that takes the contents of files until they get their names.
        limits: on the number of files.
    """

    def __init__(self, contents: Path, limits: Limits) -> None:
        self._contents = contents
        self._limits = limits
        self._numbers = count()
        self._layer = 0
        self._n_entries = 0
        self._root = _Folder(layer=0)

    def add_layer(self, entries: Iterable[TarEntry]) -> None:
        """Lay the next layer over those before.

        Raises:
            ArchiveRejected: it breaks a rule.
        """
        self._layer += 1
        for entry in entries:
            self._add(entry)

    def write(self, root: Path) -> None:
        """Write the tree into a new folder, readable by every user; each content can be written once only."""
        for name in MOUNT_POINTS:
            self._root.children[name] = _Folder(layer=self._layer)
        self._write_folder(self._root, root, {})

    def _add(self, entry: TarEntry) -> None:
        parts = [part for part in entry.path.split("/") if part not in {"", "."}]
        _check_parts(entry, parts)
        self._count()
        if not parts:
            return
        name = parts.pop()
        folder = self._find_folder(parts, entry)
        if name.startswith(_WHITEOUT):
            self._remove(folder, name, entry)
        elif entry.type is EntryType.FOLDER:
            child = folder.children.get(name)
            child = child if isinstance(child, _Folder) else self._make_folder(folder, name, entry)
            child.layer = self._layer
        elif (node := self._make_node(entry)) is not None:
            folder.children[name] = node

    def _make_node(self, entry: TarEntry) -> _File | _Link | None:
        if entry.type is EntryType.FILE:
            return self._store(entry)
        if entry.type is EntryType.SYMLINK:
            if not entry.link or "\0" in entry.link or len(os.fsencode(entry.link)) > _PATH_BYTES:
                raise link(entry.path)
            return _Link(target=entry.link, layer=self._layer)
        if entry.type is EntryType.HARD_LINK:
            return replace(self._find_linked(entry), layer=self._layer)
        if entry.path.lstrip("./").startswith("dev/"):  # which the sandbox has of its own
            return None
        raise special_file(entry.path)

    def _store(self, entry: TarEntry) -> _File:
        number = next(self._numbers)
        path = self._contents / str(number)
        with path.open("xb") as file:
            for chunk in entry.chunks():
                file.write(chunk)
        path.chmod(0o755 if entry.mode & 0o111 else 0o644)
        modified_s = min(max(entry.modified_s, 0), _LATEST_S)
        os.utime(path, (modified_s, modified_s))  # by which Python knows whether what it has compiled is current
        return _File(number=number, layer=self._layer)

    def _find_linked(self, entry: TarEntry) -> _File | _Link:
        parts = [part for part in entry.link.split("/") if part not in {"", "."}]
        node = self._find_folder(parts[:-1], entry).children.get(parts[-1]) if parts else None
        if ".." in parts or node is None or isinstance(node, _Folder):
            raise ArchiveRejected(
                ArchiveFault.LINK,
                f"{entry.path!r:.200} is a hard link to {entry.link!r:.200}, expected an earlier file of the image; "
                "build the image again.",
            )
        return node

    def _find_folder(self, parts: list[str], entry: TarEntry) -> _Folder:
        """Return a folder, made where it is missing; links on the way are followed and never lead out of the root.

        Raises:
            ArchiveRejected: links lead in a circle, or the path is too long.
        """
        above, waiting, links = [self._root], parts[::-1], 0
        while waiting:
            part = waiting.pop()
            if part in {"", "."}:
                continue
            if part == "..":
                above = above[:-1] or above
                continue
            child = above[-1].children.get(part)
            if isinstance(child, _Link):
                links += 1
                if links > _LINKS_FOLLOWED:
                    raise ArchiveRejected(
                        ArchiveFault.LINK, f"{entry.path!r:.200} lies below links that lead in a circle; remove them."
                    )
                above = above[:1] if child.target.startswith("/") else above
                waiting += child.target.split("/")[::-1]
                continue
            if not isinstance(child, _Folder):
                child = self._make_folder(above[-1], part, entry)
            above.append(child)
        return above[-1]

    def _make_folder(self, parent: _Folder, name: str, entry: TarEntry) -> _Folder:
        """Return a new folder, in the place of a file of a layer below where there is one."""
        self._count()
        folder = _Folder(
            layer=self._layer, depth=parent.depth + 1, path_bytes=parent.path_bytes + len(os.fsencode(name)) + 1
        )
        if folder.depth > _DEPTH or folder.path_bytes > _PATH_BYTES or len(os.fsencode(name)) > _NAME_BYTES:
            raise ArchiveRejected(
                ArchiveFault.TOO_DEEP,
                f"{entry.path!r:.200} lies more than {_DEPTH} folders or {_PATH_BYTES} bytes deep; nest less.",
            )
        parent.children[name] = folder
        return folder

    def _remove(self, folder: _Folder, name: str, entry: TarEntry) -> None:
        """Remove what a whiteout names of the layers below."""
        if name == _OPAQUE:
            self._prune(folder)
            return
        if name.startswith(_NOTES):
            return
        removed = name.removeprefix(_WHITEOUT)
        if removed in {"", ".", ".."}:
            raise ArchiveRejected(
                ArchiveFault.PARENT_PATH,
                f"{entry.path!r:.200} removes the folder that it lies in, or the one above, expected the name of a "
                "file; build the image again.",
            )
        node = folder.children.get(removed)
        if node is not None and not self._is_of_layer(node):
            del folder.children[removed]

    def _prune(self, folder: _Folder) -> None:
        folder.children = {name: node for name, node in folder.children.items() if self._is_of_layer(node)}

    def _is_of_layer(self, node: _Node) -> bool:
        """Return whether the layer brought a node; of a folder, what layers below brought is removed."""
        if isinstance(node, _Folder):
            self._prune(node)
            return node.layer == self._layer or bool(node.children)
        return node.layer == self._layer

    def _count(self) -> None:
        self._n_entries += 1
        if self._n_entries > self._limits.image_files:
            raise ArchiveRejected(
                ArchiveFault.TOO_MANY_FILES,
                f"The layers of the image hold more than {self._limits.image_files} files and folders; install less.",
            )

    def _write_folder(self, folder: _Folder, path: Path, places: dict[int, Path]) -> None:
        path.mkdir()
        path.chmod(0o755)
        for name, node in folder.children.items():
            target = path / name
            if isinstance(node, _Folder):
                self._write_folder(node, target, places)
            elif isinstance(node, _Link):
                target.symlink_to(node.target)
            elif node.number in places:
                os.link(places[node.number], target)
            else:
                places[node.number] = (self._contents / str(node.number)).rename(target)


def _check_parts(entry: TarEntry, parts: Iterable[str]) -> None:
    for part in parts:
        if part == "..":
            raise ArchiveRejected(
                ArchiveFault.PARENT_PATH, f"{entry.path!r:.200} leads out of the image; build the image again."
            )
        if "\0" in part or len(os.fsencode(part)) > _NAME_BYTES:
            raise ArchiveRejected(
                ArchiveFault.NAME_TOO_LONG,
                f"{entry.path!r:.200} has a name that file systems do not take; rename the file.",
            )
