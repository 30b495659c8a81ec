"""Names and content of a log's static files (https://c2sp.org/tlog-tiles), and a log as an outsider reads it."""

import json
import re
from collections.abc import Callable, Iterator, Sequence
from typing import Final

from vitac.errors import VitacError

from .merkle import TILE_WIDTH, ProofRejected, Tree, hash_leaf
from .notes import Checkpoint, NoteRejected, VerifierKey

CHECKPOINT_PATH: Final = "checkpoint"
KEY_PATH: Final = "key"
"""Path of the verifier key."""
WITNESSED_PATH: Final = "witnessed.json"
"""Path of the newest checkpoint that each witness has signed; not part of the standard."""
ENTRIES: Final = "entries"
MAX_ENTRY_BYTES: Final = 0xFFFF
_HASH_BYTES = 32

Fetch = Callable[[str], bytes | None]
"""Returns the content of a path below `/log/`; None where there is none."""


class TileMissing(VitacError):
    """A log does not have a file that the size in its checkpoint demands."""


def make_tile_path(level: int | str, number: int, width: int = TILE_WIDTH) -> str:
    """Return where a tile is, or with the level ENTRIES the entries of a tile."""
    groups = f"{number:03d}"
    while len(groups) % 3:
        groups = f"0{groups}"
    parts = [groups[at : at + 3] for at in range(0, len(groups), 3)]
    folders = "".join(f"x{part}/" for part in parts[:-1])
    return f"tile/{level}/{folders}{parts[-1]}{f'.p/{width}' if width < TILE_WIDTH else ''}"


def parse_tile_name(name: str) -> tuple[int, int] | None:
    """Return number and width of a tile from the end of its path; None where it is none."""
    match = re.fullmatch(r"((?:x\d{3}/){0,4}\d{3})(?:\.p/([1-9]\d{0,2}))?", name, re.ASCII)
    if match is None or (width := int(match[2] or TILE_WIDTH)) > TILE_WIDTH:
        return None
    number = int(match[1].replace("x", "").replace("/", ""))
    return (number, width) if make_tile_path("", number, width) == f"tile//{name}" else None


def pack_entries(entries: Sequence[bytes]) -> bytes:
    """Return entries as a file."""
    return b"".join(len(entry).to_bytes(2) + entry for entry in entries)


def unpack_entries(content: bytes) -> list[bytes]:
    """Return the entries of a file.

    Raises:
        ProofRejected: it ends within one.
    """
    entries, at = [], 0
    while at < len(content):
        end = at + 2 + int.from_bytes(content[at : at + 2])
        if end > len(content):
            raise ProofRejected("A file of entries ends within an entry.")
        entries.append(content[at + 2 : end])
        at = end
    return entries


class PublishedLog:
    """A log as everybody can read it: at an address, or as files in a folder.

    Raises:
        TileMissing: here and in all methods, a file is not there.
        NoteRejected: its checkpoint is none, or of another log.
    """

    def __init__(self, fetch: Fetch, key: VerifierKey) -> None:
        self._fetch = fetch
        self.key = key
        self.checkpoint = read_checkpoint(fetch)
        self.checkpoint.require_signature(key)
        self.tree = Tree(self.checkpoint.size, self._read_hashes)

    def entries(self) -> Iterator[bytes]:
        """Yield all entries, each as its leaf says.

        Raises:
            ProofRejected: an entry is another one than that of the tree.
        """
        for first in range(0, self.checkpoint.size, TILE_WIDTH):
            number, width = first // TILE_WIDTH, min(TILE_WIDTH, self.checkpoint.size - first)
            entries = unpack_entries(self._read(ENTRIES, number, width))[:width]
            leaves = self._read_hashes(0, number, width)
            if len(entries) != width:
                raise ProofRejected(f"Entries from {first + 1}: expected {width} in their file, got {len(entries)}.")
            for offset, (entry, leaf) in enumerate(zip(entries, leaves, strict=True)):
                if hash_leaf(entry) != leaf:
                    raise ProofRejected(f"Entry {first + offset + 1} is not the one that its tile has the hash of.")
                yield entry

    def read_witnessed(self) -> list[Checkpoint]:
        """Return the newest checkpoint that each witness has signed, of those that the log has signed, too."""
        checkpoints = []
        for text in _texts(self._fetch(WITNESSED_PATH)):
            checkpoint = Checkpoint.parse(text)
            checkpoint.require_signature(self.key)
            checkpoints.append(checkpoint)
        return checkpoints

    def _read_hashes(self, level: int, number: int, width: int) -> list[bytes]:
        content = self._read(level, number, width)[: width * _HASH_BYTES]
        if len(content) != width * _HASH_BYTES:
            raise ProofRejected(
                f"{make_tile_path(level, number, width)}: expected {width} hashes, got {len(content)} bytes."
            )
        return [content[at : at + _HASH_BYTES] for at in range(0, len(content), _HASH_BYTES)]

    def _read(self, level: int | str, number: int, width: int) -> bytes:
        """Return a tile; a log may replace a partial one by the whole."""
        for path in (make_tile_path(level, number, width), make_tile_path(level, number)):
            content = self._fetch(path)
            if content is not None:
                return content
        path = make_tile_path(level, number, width)
        raise TileMissing(f"The log has no {path}, which its checkpoint of {self.checkpoint.size} entries demands.")


def read_key(fetch: Fetch) -> VerifierKey:
    """Return the key that a log says is its own.

    Raises:
        TileMissing: it does not say.
        NoteRejected: it is none.
    """
    content = fetch(KEY_PATH)
    if content is None:
        raise TileMissing("The log does not say its key; give it as --key.")
    return VerifierKey.parse(content.decode(errors="replace"))


def read_checkpoint(fetch: Fetch) -> Checkpoint:
    """Return the checkpoint of a log, whoever signed it.

    Raises:
        TileMissing: there is none.
        NoteRejected: it does not have the form of one.
    """
    content = fetch(CHECKPOINT_PATH)
    if content is None:
        raise TileMissing("There is no log: its file 'checkpoint' is missing.")
    return Checkpoint.parse(content.decode(errors="replace"))


def _texts(content: bytes | None) -> list[str]:
    """Return the texts of a JSON list; none where there is no such file."""
    try:
        texts = json.loads(content or b"[]")
    except ValueError:
        texts = None
    if not isinstance(texts, list) or not all(isinstance(text, str) for text in texts):
        raise NoteRejected(f"{WITNESSED_PATH}: expected a JSON list of checkpoints.")
    return texts
