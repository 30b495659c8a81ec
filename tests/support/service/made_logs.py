"""Logs for tests as files, with entries that are made up, signed by the key of `made_receipts`."""

import json
from collections.abc import Callable, Sequence
from datetime import timedelta
from typing import Any

from made_receipts import KEY, PUBLIC_KEY, WHEN, a_result
from vitac.server.transparency.entries import CompetitionApplied, Content, FinalBoard, LogEntry, SealedListChanged
from vitac.server.transparency.merkle import TILE_WIDTH, make_tree
from vitac.server.transparency.notes import Checkpoint, make_log_key, sign_checkpoint
from vitac.server.transparency.tiles import PublishedLog, make_tile_path, pack_entries

LOG_KEY = make_log_key(bytes.fromhex(PUBLIC_KEY))
FILES_ADDRESS = "https://arena.example"
Files = dict[str, bytes]


def make_entries(n_entries: int, change: Callable[[int], Content | None] = lambda _: None) -> list[LogEntry]:
    """Entries of results, a second apart; `change` gives another content for a number, or None."""
    contents = (change(number) or a_result(number, issued_at=at(number)) for number in range(1, n_entries + 1))
    return [content.entry(number) for number, content in enumerate(contents, start=1)]


def at(number: int) -> Any:
    """When the entry of a number was issued."""
    return WHEN + timedelta(seconds=number)


def apply_file(number: int, *witnesses: str, demanded: int = 0, closes: int = 10_000) -> CompetitionApplied:
    """A competition file with witnesses, whose stage closes when an entry of some number is issued."""
    stage = {"name": "only", "witnesses": demanded, "closes": at(closes).isoformat()}
    definition = {"witnesses": list(witnesses), "tracks": {"track_1": {"stages": [stage]}}}
    return CompetitionApplied(issued_at=at(number), competition="cup", definition=definition)


def change_list(number: int, change: Any, commitment: str, secret: str | None = None) -> SealedListChanged:
    """Something that happened to a sealed list."""
    return SealedListChanged(
        issued_at=at(number), competition="cup", track="track_1", stage="only", change=change, commitment=commitment,
        secret=secret,
    )  # fmt: skip


def final_board(number: int) -> FinalBoard:
    """A board without entries."""
    return FinalBoard(
        issued_at=at(number), competition="cup", track="track_1", stage="only", entries=0, board_sha256="0" * 64
    )


def publish(entries: Sequence[LogEntry], *, key: bytes = KEY, witnessed: Sequence[Checkpoint] = ()) -> Files:
    """The files that a service with these entries has below `/log/`."""
    tree = make_tree([entry.leaf_hash for entry in entries])
    checkpoint = sign_checkpoint(key, size=tree.size, root=tree.root())
    files = {"checkpoint": str(checkpoint).encode(), "key": str(LOG_KEY).encode()}
    files["witnessed.json"] = json.dumps(list(map(str, witnessed))).encode()
    level, n_hashes = 0, tree.size
    while n_hashes:
        for number in range(-(-n_hashes // TILE_WIDTH)):
            first, width = TILE_WIDTH * number, min(TILE_WIDTH, n_hashes - TILE_WIDTH * number)
            files[make_tile_path(level, number, width)] = b"".join(tree.read_tile(level, number, width))
            if level == 0:
                packed = pack_entries([entry.leaf() for entry in entries[first : first + width]])
                files[make_tile_path("entries", number, width)] = packed
        level, n_hashes = level + 1, n_hashes // TILE_WIDTH
    return files


def opened(files: Files) -> PublishedLog:
    """The log as an outsider opens it."""
    return PublishedLog(files.get, LOG_KEY)
