"""Puts the layers of an image together; called by `image`.

The tree of files is put together in memory, so that every link is followed and every file removed there. Then it is
written once, into folders that are all our own: no path that is written ever leads through a link of the image.
"""

import os
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from itertools import count
from pathlib import Path
from typing import Final

from ..agent.isolation.image_program import MOUNT_POINTS
from ..agent.limits import Limits
from .names import ArchiveFault, ArchiveRejected, link, special_file
from .tar_entries import EntryType, TarEntry

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
