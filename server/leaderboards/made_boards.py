"""Boards as they were last made: kept by this process until a new best entry changes them.

An entry never changes, since a completed evaluation, its submission's name and its team's name do not. So the ids of
the best entries say whether a board that was made before is still right.
"""

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from importlib.metadata import version

from vitac.evaluator.version import evaluator_version

from ..views.leaderboards import LeaderboardView
from .best_entries import BestEntry, Board


@dataclass(frozen=True, kw_only=True)
class MadeBoard:
    """A leaderboard, and as the API sends it."""

    view: LeaderboardView

    @cached_property
    def body(self) -> bytes:
        """The view as JSON."""
        return self.view.model_dump_json().encode()


class MadeBoards:
    """Keeps each board as it was last made."""

    def __init__(self) -> None:
        self._made: dict[Board, MadeBoard] = {}

    def get(self, board: Board, revision: str, make: Callable[[], LeaderboardView]) -> MadeBoard:
        """Return the board of that revision, made anew only where another one is kept."""
        made = self._made.get(board)
        if made is None or made.view.revision != revision:
            made = MadeBoard(view=make())
            self._made[board] = made
        return made


def revision_of(board: Board, entries: Sequence[BestEntry]) -> str:
    """Return what changes with everything that a board shows: its entries, their order, the software that made it."""
    parts = [version("vitac-arena"), evaluator_version(), board.track, board.kind, board.task or ""]
    parts += [f"{entry.rank} {entry.evaluation_id}" for entry in entries]
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()[:32]
