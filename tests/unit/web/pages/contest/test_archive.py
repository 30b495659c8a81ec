from datetime import UTC, datetime

from asgi_browser import AsgiBrowser
from made_receipts import a_receipt
from page_fixtures import TASK, FixedData, a_leaderboard, a_score, an_entry
from vitac.server.views.contest.competition import CompetitionTrackView, CompetitionView, WinnerView


def test_the_archive_shows_winners_boards_and_how_to_cite(data: FixedData, browser: AsgiBrowser) -> None:
    assert browser.get("/competition/archive").status_code == 404
    track = CompetitionTrackView(
        name="track_1", title="Touch", taken_here=True, ranking=["success_rate"], ties="", stages=[], prizes=[]
    )
    won = WinnerView(
        track="track_1", place="first", rank=1, team="<Bears>", amount=2000, success_rate=0.9, result_hash="9f3b" * 16
    )
    data.cup = CompetitionView(
        name="cup", title="The cup", summary="", website=None, contact=None, rules=[], currency="USD",
        teams_locked=None, tracks=[track], frozen_at=None, finalized_at=datetime(2031, 3, 1, tzinfo=UTC), winners=[won],
    )  # fmt: skip
    board = a_leaderboard(an_entry(1, "Bears", a_score((84, 80, 77), 4.31), task=TASK), task=TASK)
    data.board = board.model_copy(update={"stage": "final"})
    html = browser.get("/competition/archive").text
    for text in ("Touch, final", "&lt;Bears&gt;", "@misc{cup}", a_receipt().link.public_key, "2031-03-01"):
        assert text in html, text
    assert 'href="/competition/archive"' in browser.get("/competition").text
    data.board = a_leaderboard()
    assert "Nobody took part" in browser.get("/competition/archive").text
