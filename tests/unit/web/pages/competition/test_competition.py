import re
from datetime import UTC, datetime, timedelta

from asgi_browser import AsgiBrowser
from page_service import FixedData
from vitac.evaluator.submission_kinds import SubmissionKind
from vitac.evaluator.tracks import ListKind
from vitac.server.views.competition import CompetitionTrackView, CompetitionView, PrizeView, StageView, WinnerView
from vitac.server.views.correspondence import AnnouncementView
from vitac.web.pages.competition import list_countdowns

DAY = timedelta(days=1)
OPENS, CLOSES = datetime(2031, 1, 1, tzinfo=UTC), datetime(2031, 2, 1, 12, tzinfo=UTC)


def a_competition(**changes: object) -> CompetitionView:
    stage = StageView(
        name="final", title="The <final>", opens=OPENS, closes=CLOSES, is_open=True, accepts=[SubmissionKind.MODEL],
        list_kind=ListKind.SEALED, commitment="c0ffee", secret=None, scored_runs=3, attempts=None,
        qualified="the best 3 teams of the stage before",
    )  # fmt: skip
    track = CompetitionTrackView(
        name="track_1", title="Touch", taken_here=True, ranking=["success_rate"], ties="The earlier is in front.",
        stages=[stage], prizes=[PrizeView(place="first", amount=2000, winners=2, note="a talk")],
    )  # fmt: skip
    values: dict[str, object] = {
        "name": "cup", "title": "The cup", "summary": "Who is best?", "website": "https://cup.example",
        "contact": "mail@cup.example", "rules": ["Be <fair>."], "currency": "USD", "teams_locked": CLOSES,
        "tracks": [track, track.model_copy(update={"name": "mail", "taken_here": False})], "frozen_at": None,
        "finalized_at": None, "winners": [],
    }  # fmt: skip
    return CompetitionView.model_validate(values | changes)


def shown(data: FixedData, browser: AsgiBrowser, **changes: object) -> str:
    data.cup = a_competition(**changes)
    answer = browser.get("/competition")
    assert answer.status_code == 200
    return answer.text.replace("\N{NARROW NO-BREAK SPACE}", " ")


def test_a_visitor_sees_schedule_rules_prizes_and_commitment(data: FixedData, browser: AsgiBrowser) -> None:
    html = shown(data, browser)
    for text in (
        "The cup",
        "2031-02-01 12:00 UTC",
        "c0ffee",
        "2 000 USD (2 teams)",
        "a talk",
        "3 scored runs at most",
        "Open",
    ):
        assert text in html, text
    assert "collected by the organizers" in html
    assert 'class="nowrap deadline" datetime="2031-02-01T12:00:00Z"' in html


def test_what_closes_or_opens_next_is_counted_down_once_for_tracks_that_share_it() -> None:
    cup = a_competition()
    stage = cup.tracks[0].stages[0]
    final = stage.model_copy(update={"title": "Later", "opens": CLOSES, "closes": CLOSES + 9 * DAY})
    staged = cup.tracks[0].model_copy(update={"stages": [stage, final]})
    cup = cup.model_copy(update={"tracks": [staged, staged.model_copy(update={"title": "Sight"})]})

    def shown_at(now: datetime) -> list[tuple[object, ...]]:
        return [(next_.tracks, next_.stage, next_.closes, next_.moment) for next_ in list_countdowns(cup, now)]

    both = ("Touch", "Sight")
    assert shown_at(OPENS - DAY) == [(both, "The <final>", False, OPENS)]
    assert shown_at(OPENS) == [(both, "The <final>", True, CLOSES)]
    assert shown_at(CLOSES) == [(both, "Later", True, CLOSES + 9 * DAY)]
    assert shown_at(CLOSES + 9 * DAY) == []


def test_the_countdown_is_there_without_scripts(data: FixedData, browser: AsgiBrowser) -> None:
    html = shown(data, browser)
    assert re.search(r"opens in</dt><dd><span data-until=\"2031-01-01[^>]+>\d+ days \d+ h</span>", html)
    assert "data-until" not in shown(data, browser, finalized_at=OPENS)


def test_words_of_the_file_are_shown_as_text(data: FixedData, browser: AsgiBrowser) -> None:
    html = shown(data, browser)
    assert "The &lt;final&gt;" in html
    assert "Be &lt;fair&gt;." in html


def test_winners_and_a_published_secret_are_shown_at_the_end(data: FixedData, browser: AsgiBrowser) -> None:
    assert "Winners" not in shown(data, browser)
    winner = WinnerView(
        track="track_1", place="first", rank=1, team="A<b>", amount=2000, success_rate=0.5, result_hash="h"
    )
    html = shown(data, browser, winners=[winner], finalized_at=CLOSES)
    assert "A&lt;b&gt;" in html
    assert "Final since" in html


def test_a_frozen_competition_says_so(data: FixedData, browser: AsgiBrowser) -> None:
    assert "have been frozen since" in shown(data, browser, frozen_at=OPENS)


def test_without_a_competition_there_is_no_page(browser: AsgiBrowser) -> None:
    assert browser.get("/competition").status_code == 404


def test_quotas_appeals_and_judging_are_told(data: FixedData, browser: AsgiBrowser) -> None:
    stage = a_competition().tracks[0].stages[0].model_copy(update={"scored_runs": 1, "attempts": 2})
    track = a_competition().tracks[0].model_copy(update={"stages": [stage], "judging": "Judges decide <it>."})
    html = shown(data, browser, tracks=[track], appeal_days=1, rules=[], teams_locked=None)
    for text in ("1 scored run at most", "2 attempts at most", "until 1 day after", "Judges decide &lt;it&gt;."):
        assert text in html, text
    plain = shown(data, browser, rules=[], teams_locked=None)
    assert "/appeals" not in plain
    assert 'id="rules"' not in plain


def test_the_newest_announcements_and_hidden_names_are_told(data: FixedData, browser: AsgiBrowser) -> None:
    plain = shown(data, browser)
    assert "All announcements" not in plain
    assert "under random names" not in plain
    data.said = [
        AnnouncementView(id=number, title=f"News <{number}>", text="All\nis well.", published_at=OPENS)
        for number in (4, 3, 2, 1)
    ]
    html = shown(data, browser, anonymous=True)
    for text in ("News &lt;4&gt;", "News &lt;2&gt;", "All\nis well.", 'href="/announcements"', "under random names"):
        assert text in html, text
    assert "News &lt;1&gt;" not in html, "the others are on the page of announcements"
    assert "under random names" not in shown(data, browser, anonymous=True, finalized_at=CLOSES)
