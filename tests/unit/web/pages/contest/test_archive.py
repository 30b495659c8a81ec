from asgi_browser import AsgiBrowser
from made_receipts import a_receipt
from page_fixtures import TASK, FixedData, a_finished_cup, a_leaderboard, a_score, an_entry


def test_the_archive_shows_winners_boards_and_how_to_cite(data: FixedData, browser: AsgiBrowser) -> None:
    assert browser.get("/competition/archive").status_code == 404
    data.cup = a_finished_cup()
    board = a_leaderboard(an_entry(1, "Bears", a_score((84, 80, 77), 4.31), task=TASK), task=TASK)
    data.board = board.model_copy(update={"stage": "final"})
    html = browser.get("/competition/archive").text
    for text in ("Touch, final", "&lt;Bears&gt;", "@misc{cup}", a_receipt().link.public_key, "2031-03-01"):
        assert text in html, text
    for page in ("/competition/archive", "/competition"):
        assert '<td role="cell">Touch</td>' in browser.get(page).text, "people know the title of a track"
    assert 'href="/competition/archive"' in browser.get("/competition").text
    data.board = a_leaderboard()
    assert "Nobody took part" in browser.get("/competition/archive").text
