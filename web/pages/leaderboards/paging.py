"""Boards in pages, with a search. Called by `leaderboard` and `logs`."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar
from urllib.parse import urlencode

from starlette.requests import Request
from vitac.server.leaderboards.reading import BoardSearch
from vitac.server.views.leaderboards import BoardEntryView

PAGE_ENTRIES = 50
SECTION_ENTRIES = 25
"""Of each board, where a page has several."""

EntryT = TypeVar("EntryT", bound=BoardEntryView)


@dataclass(frozen=True, kw_only=True)
class BoardPage(Generic[EntryT]):
    """Some entries of a board.

    Attributes:
        entries: those of the page.
        number: of the page, from 1.
        pages: how many there are.
        search: what was searched for.
        found: number of entries with that.
        total: number of entries of the whole board.
        own: the visitor's first entry on the whole board.
        own_page: number of the page of all teams that has it.
        size: maximum number of entries of a page.
        address: of the board, with its task.
        parameter: what names the number of the page in an address.
        section: id of the board on its page; empty: it is the whole page.
    """

    entries: Sequence[EntryT]
    number: int
    pages: int
    search: BoardSearch
    found: int
    total: int
    own: EntryT | None
    own_page: int
    size: int
    address: str
    parameter: str
    section: str

    def link(self, number: int) -> str:
        """Return the address of a page of the same search."""
        asked = self.search.query() + ([(self.parameter, str(number))] if number > 1 else [])
        return self._add_query(asked) + (f"#{self.section}" if self.section else "")

    @property
    def own_link(self) -> str:
        """Return the address of the visitor's own row."""
        asked = self._add_query([(self.parameter, str(self.own_page))] if self.own_page > 1 else [])
        return f"{asked}#{self.section or 'own'}"

    def _add_query(self, asked: list[tuple[str, str]]) -> str:
        if not asked:
            return self.address
        return f"{self.address}{'&' if '?' in self.address else '?'}{urlencode(asked)}"


def board_page(
    request: Request, address: str, entries: Sequence[EntryT], own_names: Collection[str], *, section: str = ""
) -> BoardPage[EntryT]:
    """Return the page that a request asks for; one that there is not is the nearest one.

    Args:
        request: with a search, and `page`, or `page-SECTION` of a section.
        address: of the board.
        entries: all of them.
        own_names: under which the visitor's team may be there.
        section: id of the board, where a page has several.

    Raises:
        ServiceError: the search cannot be read.
    """
    parameter = f"page-{section}" if section else "page"
    search = BoardSearch.read(request.query_params)
    matching = search.find(entries)
    size = SECTION_ENTRIES if section else PAGE_ENTRIES
    pages = max(1, -(-len(matching) // size))
    number = min(pages, max(1, _whole(request.query_params.get(parameter, "1"))))
    place = next((place for place, entry in enumerate(entries) if entry.team in own_names), None)
    return BoardPage(
        entries=matching[(number - 1) * size : number * size],
        number=number,
        pages=pages,
        search=search,
        found=len(matching),
        total=len(entries),
        own=None if place is None else entries[place],
        own_page=1 if place is None else place // size + 1,
        size=size,
        address=address,
        parameter=parameter,
        section=section,
    )


def _whole(text: str) -> int:
    return int(text) if text.isascii() and text.isdigit() and len(text) < 7 else 1
