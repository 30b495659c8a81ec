from datetime import UTC, datetime

from asgi_browser import AsgiBrowser
from made_receipts import a_receipt
from page_fixtures import TASK, a_finished_cup, a_leaderboard, a_score, an_entry
from page_service import FixedData
from vitac.server.views.competition import DisqualifiedTeamView


def test_the_archive_shows_winners_boards_and_how_to_cite(data: FixedData, browser: AsgiBrowser) -> None:
    assert browser.get("/competition/archive").status_code == 404
    data.cup = a_finished_cup()
    entry = an_entry(1, "<Bears>", a_score((84, 80, 77), 4.31), task=TASK).model_copy(
        update={"evaluator_version": "1+of_the_entry"}
    )
    board = a_leaderboard(entry, task=TASK)
    data.board = board.model_copy(update={"stage": "final", "unranked": "Made by evaluator <1+old>."})
    html = browser.get("/competition/archive").text
    for text in (
        "Touch, Final",
        "&lt;Bears&gt;",
        "@misc{cup}",
        a_receipt().public_key,
        "2031-03-01",
        "&lt;1+old&gt;",
        ">1+of_the_entry<",
    ):
        assert text in html, text
    for page in ("/competition/archive", "/competition"):
        assert '<td role="cell">Touch</td>' in browser.get(page).text, "people know the title of a track"
    assert 'href="/competition/archive"' in browser.get("/competition").text
    out = DisqualifiedTeamView(team="<Bears>", disqualified_at=datetime(2031, 4, 2, 8, tzinfo=UTC))
    assert "<s>" not in html
    assert "This page changes only when a team is disqualified, reinstated or removed.</p>" in html
    assert "Decided again" not in html
    data.cup = data.cup.model_copy(update={"disqualified": [out]})
    struck = browser.get("/competition/archive").text
    assert struck.count("<s>&lt;Bears&gt;</s>") == 2, "among the winners and on the board"
    assert struck.count("disqualified after the end") == 2
    assert "2031-04-02 08:00 UTC" in struck
    assert "struck through" in struck
    assert browser.get("/competition").text.count("<s>&lt;Bears&gt;</s>") == 1
    data.decided_again_at = datetime(2031, 4, 3, 9, tzinfo=UTC)
    decided = " ".join(browser.get("/competition/archive").text.split())
    assert "Decided again on" in decided
    assert "2031-04-03 09:00 UTC" in decided
    data.board = a_leaderboard()
    assert "Nobody took part" in browser.get("/competition/archive").text
