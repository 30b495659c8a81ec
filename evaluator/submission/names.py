"""Rules about the names in a submission, and the ways to break one; used by `archive` and `submission`."""

import unicodedata
from collections.abc import Iterable
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Final

from vitac.errors import VitacError

from ..agent.limits import Limits
from ..sensors.manifest import SENSOR_NAME
from ..sensors.package import GEL_NAME, MESH_NAME

MANIFEST_NAME: Final = "submission.yaml"
REQUIREMENTS_NAME: Final = "requirements.txt"
FIXED_NAMES: Final = (MANIFEST_NAME, REQUIREMENTS_NAME, SENSOR_NAME, GEL_NAME, MESH_NAME)
"""Files that are found directly in the submission's folder, in small or capital letters."""
IGNORED_FOLDERS: Final = frozenset(
    {
        *("__MACOSX", "__pycache__", ".git", ".idea", ".ipynb_checkpoints", ".mypy_cache"),
        *(".pytest_cache", ".ruff_cache", ".venv", ".vscode"),
    }
)
IGNORED_FILES: Final = frozenset({".ds_store", "desktop.ini", "thumbs.db"})
IGNORED_PREFIX: Final = "._"
IGNORED_SUFFIXES: Final = (".pyc",)
"""Caches and desktop files; never unpacked, never part of a digest."""
_NAMES_SHOWN: Final = 20
_SHOWN_CHARACTERS: Final = 80
_NAME_MAX_BYTES: Final = 255
_PATH_MAX_BYTES: Final = 1024
_BAD_CATEGORIES: Final = frozenset({"Cc", "Cf", "Cs", "Zl", "Zp"})
"""Controls, format characters, surrogates, line and paragraph separators."""


class ArchiveFault(StrEnum):
    """The rule that an archive or folder breaks."""

    NOT_A_ZIP = "not_a_zip"
    DAMAGED = "damaged"
    """Cut off, or contents that differ from what the archive says about them."""
    TOO_LARGE = "too_large"
    UNPACKED_TOO_LARGE = "unpacked_too_large"
    TOO_MANY_FILES = "too_many_files"
    TOO_DEEP = "too_deep"
    NAME_TOO_LONG = "name_too_long"
    COMPRESSED_TOO_MUCH = "compressed_too_much"
    ABSOLUTE_PATH = "absolute_path"
    PARENT_PATH = "parent_path"
    BAD_CHARACTERS = "bad_characters"
    DUPLICATE = "duplicate"
    CASE_DUPLICATE = "case_duplicate"
    LINK = "link"
    SPECIAL_FILE = "special_file"
    ENCRYPTED = "encrypted"
    COMPRESSION_METHOD = "compression_method"
    WRONG_TOP_FOLDER = "wrong_top_folder"
    WHEEL = "wheel"
    """A package in `wheels/` or `requirements.txt` cannot be used."""
    IMAGE = "image"
    """A file is no container image, or not one that can play here."""


class ArchiveRejected(VitacError):
    """An archive or folder breaks a rule of submissions; pack it again as the message says.

    Attributes:
        code: the rule.
        message: what was expected, what was found, what to do.
    """

    def __init__(self, code: ArchiveFault, message: str) -> None:
        super().__init__(message)
        self.code = code
        self.message = message


@dataclass(frozen=True, kw_only=True)
class NamedEntry:
    """A path (with slashes, none at the end) as an archive or a folder gives it."""

    path: str
    is_folder: bool


def is_ignored(path: str) -> bool:
    """Return whether a file is a cache or desktop file, which is not part of a submission."""
    parts = path.split("/")
    name = parts[-1]
    is_of_desktop = name.lower() in IGNORED_FILES or name.startswith(IGNORED_PREFIX)
    return bool(IGNORED_FOLDERS.intersection(parts)) or is_of_desktop or name.endswith(IGNORED_SUFFIXES)


def fixed_name(path: str) -> str:
    """Return a path below the submission's folder with one of `FIXED_NAMES` as it is written there."""
    return path.lower() if path.lower() in FIXED_NAMES else path


def describe_contents(folder: Path) -> str:
    """Return the end of a sentence that says what a folder holds, for someone who named something else."""
    if not folder.is_dir():
        return f"folder {folder} does not exist"
    return f"folder {folder} holds {listed(item.name for item in folder.iterdir() if not is_ignored(item.name))}"


def listed(names: Iterable[str]) -> str:
    """Return the first of some names in order, as text that fits a message."""
    ordered = sorted(names)
    shown = ", ".join(repr(name)[:_SHOWN_CHARACTERS] for name in ordered[:_NAMES_SHOWN]) or "nothing"
    return shown if len(ordered) <= _NAMES_SHOWN else f"{shown} and {len(ordered) - _NAMES_SHOWN} more"


def check_names(entries: Iterable[NamedEntry], limits: Limits) -> None:
    """Check names alone and against one another.

    Raises:
        ArchiveRejected: a rule about names, depth, number or duplicates is broken.
    """
    taken = _TakenPaths()
    for entry in entries:
        _check_path(entry.path, limits)
        taken.add(entry)
        if taken.n_paths > limits.archive_files:
            raise too_many_files(limits)


def too_many_files(limits: Limits) -> ArchiveRejected:
    """Return the rejection of an archive or folder with too many entries."""
    return ArchiveRejected(
        ArchiveFault.TOO_MANY_FILES,
        f"More than {limits.archive_files} files and folders; put small files together in one.",
    )


def link(path: str) -> ArchiveRejected:
    """Return the rejection of a symbolic link."""
    return ArchiveRejected(ArchiveFault.LINK, f"{path!r:.200} is a link; put the file itself there.")


def special_file(path: str) -> ArchiveRejected:
    """Return the rejection of a device, pipe or socket."""
    return ArchiveRejected(ArchiveFault.SPECIAL_FILE, f"{path!r:.200} is not a regular file or folder; leave it out.")


def _check_path(path: str, limits: Limits) -> None:
    shown = f"{path!r:.200}"
    if path.startswith("/") or path[1:2] == ":":
        raise ArchiveRejected(ArchiveFault.ABSOLUTE_PATH, f"{shown} is an absolute path; pack the folder itself.")
    parts = path.split("/")
    if any(part in {"", ".", ".."} for part in parts):
        raise ArchiveRejected(ArchiveFault.PARENT_PATH, f"{shown} has a part '..', '.' or nothing; pack plain paths.")
    if "\\" in path:
        raise ArchiveRejected(
            ArchiveFault.BAD_CHARACTERS,
            f"{shown} has backslashes, as some programs of Windows write them in place of '/'; pack the folder with "
            "Explorer, 7-Zip or `python -m zipfile -c mine.zip FOLDER`.",
        )
    if any(unicodedata.category(character) in _BAD_CATEGORIES for character in path):
        raise ArchiveRejected(ArchiveFault.BAD_CHARACTERS, f"{shown} has control characters; rename it.")
    if len(parts) - 1 > limits.archive_depth:
        raise ArchiveRejected(ArchiveFault.TOO_DEEP, f"{shown} lies more than {limits.archive_depth} folders deep.")
    if len(path.encode()) > _PATH_MAX_BYTES or max(len(part.encode()) for part in parts) > _NAME_MAX_BYTES:
        raise ArchiveRejected(ArchiveFault.NAME_TOO_LONG, f"{shown} is longer than file systems take; shorten it.")


@dataclass(kw_only=True)
class _TakenPaths:
    """Compares every path, and every folder above it, with the earlier ones."""

    _spellings: dict[str, str] = field(default_factory=dict)
    _files: set[str] = field(default_factory=set)
    _folders: set[str] = field(default_factory=set)

    @property
    def n_paths(self) -> int:
        """Files and folders so far, with the folders that paths imply."""
        return len(self._files) + len(self._folders)

    def add(self, entry: NamedEntry) -> None:
        """Add one path, as a file system would that ignores case and the encoding of accents.

        Raises:
            ArchiveRejected: duplicate, case_duplicate.
        """
        parts = entry.path.split("/")
        above = ["/".join(parts[:length]) for length in range(1, len(parts))]
        for path in (*above, entry.path):
            self._check_spelling(path)
        is_taken = entry.path in self._files or (not entry.is_folder and entry.path in self._folders)
        if is_taken or not self._files.isdisjoint(above):
            raise ArchiveRejected(ArchiveFault.DUPLICATE, f"{entry.path!r:.200} appears twice; pack each file once.")
        self._folders.update(above)
        (self._folders if entry.is_folder else self._files).add(entry.path)

    def _check_spelling(self, path: str) -> None:
        folded = unicodedata.normalize("NFC", path).casefold()
        earlier = self._spellings.setdefault(folded, path)
        if earlier != path:
            raise ArchiveRejected(
                ArchiveFault.CASE_DUPLICATE, f"{path!r:.200} and {earlier!r:.200} differ only in case or accents."
            )
