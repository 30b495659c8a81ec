import pytest
from asgi_browser import AsgiBrowser
from page_fixtures import TASK, a_score, an_entry
from seeded_site import SeededSite, words
from starlette.requests import Request
from vitac.evaluator.version import evaluator_version
from vitac.server.views.leaderboards import LeaderboardEntryView
from vitac.web.pages.leaderboards import PAGE_ENTRIES, BoardPage, board_page

SCORE = a_score((80, 74, 80), 4.92)
ENTRIES = [an_entry(rank, f"Team {rank:03d}" if rank != 120 else "Gelbots", SCORE) for rank in range(1, 151)]


def asked(
    query: str, entries: list[LeaderboardEntryView] = ENTRIES, own: str | None = None
) -> BoardPage[LeaderboardEntryView]:
    request = Request({"type": "http", "method": "GET", "path": "/", "headers": [], "query_string": query.encode()})
    return board_page(request, f"/tracks/track_1?task={TASK}", entries, {own} if own else ())


def ranks(page: BoardPage[LeaderboardEntryView]) -> list[int | None]:
    return [entry.rank for entry in page.entries]


@pytest.mark.parametrize(
    ("query", "number", "first"),
    [("", 1, 1), ("page=2", 2, 51), ("page=3", 3, 101), ("page=9", 3, 101), ("page=0", 1, 1), ("page=-1", 1, 1)],
)
def test_each_page_has_fifty_entries(query: str, number: int, first: int) -> None:
    page = asked(query)
    assert (page.number, page.pages) == (number, 3)
    assert ranks(page) == list(range(first, first + 50))


@pytest.mark.parametrize("number", ["x", "", "1" * 40, "²", "1e3"])
def test_what_is_no_number_is_the_first_page(number: str) -> None:
    assert asked(f"page={number}").number == 1


def test_search_finds_parts_of_names_in_any_case() -> None:
    page = asked("q=tEAm+00")
    assert (ranks(page), page.found, page.pages) == ([*range(1, 10)], 9, 1)
    assert asked("q=nobody").entries == []
    assert asked("q=++").search.is_empty
    assert len(asked(f"q={'x' * 1000}").search.team) == 64


def test_search_finds_a_name_however_its_spaces_and_accents_are_typed() -> None:
    entries = [an_entry(rank, team, SCORE) for rank, team in enumerate(("Söhne 07", "Straße", "Gelbots"), 1)]
    for query, found in (("+s%C3%B6hne++07+", [1]), ("So%CC%88hne", [1]), ("STRASSE", [2]), ("%EF%BC%A7el", [3])):
        page = asked(f"q={query}", entries)
        assert (ranks(page), page.found) == (found, 1), query
    assert asked("q=%00", entries).found == 3


def test_links_keep_task_and_search() -> None:
    page = asked("q=Team+%26&until=2026-03-31&rows=entries")
    assert page.link(2) == f"/tracks/track_1?task={TASK}&q=Team+%26&until=2026-03-31&rows=entries&page=2"
    assert asked("").link(1) == f"/tracks/track_1?task={TASK}"


def test_the_own_row_is_found_on_its_page() -> None:
    page = asked("", own="Gelbots")
    assert page.own is ENTRIES[119]
    assert page.own_link == f"/tracks/track_1?task={TASK}&page=3#own"
    assert asked("", own="Nobody").own is None


def test_no_entry_is_one_empty_page() -> None:
    page = asked("", [])
    assert (page.number, page.pages, page.entries) == (1, 1, [])


def test_the_board_shows_a_page_and_links_the_others_and_the_own_row(site: SeededSite) -> None:
    site.fill_board(120)
    site.score("Wolves", "last", 1)
    wolves = site.team_visitor("Wolves")
    html = wolves.get("/tracks/track_1").text
    assert html.count('<tr role="row" class=') == PAGE_ENTRIES
    assert 'href="/tracks/track_1?page=3#own"' in html
    assert "rank 123 of 123" in words(html)
    assert 'id="own"' not in html
    third = wolves.get("/tracks/track_1?page=3").text
    assert third.count('id="own"') == 1
    assert third.count('class="point own"') == 1
    assert 'href="/tracks/track_1?page=3" aria-current="page"' in third
    assert third.index("<summary>How this board was made") < third.index(evaluator_version())


def test_a_search_says_what_it_looked_for_and_a_wrong_day_is_named(site: SeededSite) -> None:
    site.fill_board(60)
    browser = site.visitor()
    nobody = browser.get('/tracks/track_1?q="<b>').text
    assert "in the name: none of 62." in words(nobody)
    assert "&lt;b&gt;" in nobody
    assert "<b>" not in nobody
    html = browser.get("/tracks/track_1?q=Team+01&since=2020-01-31&rows=entries").text
    assert "with “ Team 01 ” in the name, submitted from 2020-01-31 (UTC): 10 of 62." in words(html)
    for field in ('value="Team 01"', 'value="2020-01-31"', '<option value="entries" selected>'):
        assert field in html
    only = browser.get(f"/tracks/track_1?task={TASK}&rows=baselines").text
    assert "Only the baselines are shown." in only
    assert (only.count('class="reference"'), only.count('class="leader')) == (2, 0)
    assert f'<input type="hidden" name="task" value="{TASK}">' in only
    wrong = browser.get("/tracks/track_1?since=31.1.")
    assert wrong.status_code == 422
    assert "Expected a day as 2026-03-31 as since" in wrong.text


def test_a_small_board_needs_no_pages_and_no_search(browser: AsgiBrowser) -> None:
    html = browser.get("/tracks/track_1").text
    assert 'role="search"' not in html
    assert 'class="pages"' not in html
    assert "By date" in html


def test_each_of_several_boards_of_a_page_has_a_number_of_its_own() -> None:
    request = Request(
        {"type": "http", "method": "GET", "path": "/", "headers": [], "query_string": b"q=team&page-b=2&page=3"}
    )
    first, second = (board_page(request, "/logs", ENTRIES, "Gelbots", section=section) for section in "ab")
    assert (first.number, second.number) == (1, 2)
    assert second.link(3) == "/logs?q=team&page-b=3#b"
    assert second.own_link == "/logs?page-b=5#b"
    assert (second.total, second.found) == (150, 149)
