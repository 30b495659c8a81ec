"""Boards in pages of fifty, with a search by team. Called by `tracks`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING
from urllib.parse import urlencode

if TYPE_CHECKING:
    from collections.abc import Sequence

    from starlette.requests import Request
    from vitac.server.views.leaderboards import LeaderboardEntryView

PAGE_ENTRIES = 50
MAX_SEARCH = 64


@dataclass(frozen=True, kw_only=True)
class BoardPage:
    """Some entries of a board.

    Attributes:
        entries: those of the page.
        number: of the page, from 1.
        pages: how many there are.
        search: the text that teams were searched for; empty: all teams.
        found: number of entries with that text.
        own: the visitor's entry on the whole board.
        own_page: number of the page of all teams that has it.
        address: of the board, with its task.
    """

    entries: Sequence[LeaderboardEntryView]
    number: int
    pages: int
    search: str
    found: int
    own: LeaderboardEntryView | None
    own_page: int
    address: str

    def link(self, number: int) -> str:
        """Return the address of a page of the same search."""
        asked = ([("q", self.search)] if self.search else []) + ([("page", str(number))] if number > 1 else [])
        return self._with(asked)

    @property
    def own_link(self) -> str:
        """Return the address of the visitor's own row."""
        return self._with([("page", str(self.own_page))] if self.own_page > 1 else []) + "#own"

    def _with(self, asked: list[tuple[str, str]]) -> str:
        if not asked:
            return self.address
        return f"{self.address}{'&' if '?' in self.address else '?'}{urlencode(asked)}"


def board_page(
    request: Request, address: str, entries: Sequence[LeaderboardEntryView], own_team: str | None
) -> BoardPage:
    """Return the page that a request asks for; one that there is not is the nearest one.

    Args:
        request: with `q`, part of a team's name in any case, and `page`.
        address: of the board.
        entries: all of them.
        own_team: name of the visitor's team.
    """
    search = request.query_params.get("q", "").strip()[:MAX_SEARCH]
    found = [entry for entry in entries if search.casefold() in entry.team.casefold()] if search else list(entries)
    pages = max(1, -(-len(found) // PAGE_ENTRIES))
    number = min(pages, max(1, _whole(request.query_params.get("page", "1"))))
    place = next((place for place, entry in enumerate(entries) if entry.team == own_team), None)
    return BoardPage(
        entries=found[(number - 1) * PAGE_ENTRIES : number * PAGE_ENTRIES],
        number=number,
        pages=pages,
        search=search,
        found=len(found),
        own=None if place is None else entries[place],
        own_page=1 if place is None else place // PAGE_ENTRIES + 1,
        address=address,
    )


def _whole(text: str) -> int:
    return int(text) if text.isascii() and text.isdigit() and len(text) < 7 else 1
