import re
from collections.abc import Mapping
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

from asgi_browser import AsgiBrowser
from seeded_site import SeededSite, words
from service_factories import TRACK
from vitac.server.accounts.messages import publish_announcement
from vitac.server.competitions.applying import freeze_boards
from vitac.server.competitions.competition import Competition
from vitac.server.competitions.definition import read_competition
from vitac.server.competitions.sealing import seal
from vitac.server.competitions.view import competition_view
from vitac.server.decisions import entered_results
from vitac.server.decisions.finishing import finalize
from vitac.server.principals import CONSOLE
from vitac.web.pages.competition import list_countdowns

from competitions import make_competition, moved, open_now, put_in_place, stored_stage

DAY = timedelta(days=1)
NOW = datetime.now(UTC)
EDITION_2026 = Path(__file__).parents[5] / "competitions" / "vitac-2026.yaml"


def cup(*, days: float = 0, **changes: Any) -> dict[str, Any]:
    """A competition of one stage, which has been open for a day and is open for another month."""
    content = make_competition(**changes)
    del content["tracks"][TRACK]["stages"][1:]
    content["tracks"][TRACK]["stages"][0]["title"] = "The <final>"
    return moved(open_now(content), days)


FULL: dict[str, Any] = {
    "summary": "Who is best?", "website": "https://cup.example", "contact": "mail@cup.example", "rules": ["Be <fair>."],
    "teams_locked": (NOW + 9 * DAY).isoformat(), "appeal_days": 1,
    "prizes": [{"place": "first", "amount": 2000, "winners": 2, "note": "a talk"}],
}  # fmt: skip


def shown(site: SeededSite, content: Mapping[str, Any]) -> str:
    site.hold(content)
    answer = site.visitor().get("/competition")
    assert answer.status_code == 200
    return answer.text.replace("\N{NARROW NO-BREAK SPACE}", " ")


def test_a_visitor_sees_schedule_quotas_rules_prizes_and_commitment_as_text(site: SeededSite) -> None:
    content = cup(**FULL)
    stage = content["tracks"][TRACK]["stages"][0]
    stage |= {"list": "sealed", "accepts": ["model"], "quotas": {"scored_runs": 1, "attempts": 2}}
    content["tracks"]["mail"] = content["tracks"][TRACK] | {"title": "By mail", "taken_here": False, "prizes": []}
    site.hold(content)
    with site.database.transaction() as session:
        commitment = seal(session, CONSOLE, stored_stage(session, TRACK, stage["name"])).commitment
    html = shown(site, content)
    for text in ("The &lt;final&gt;", "Be &lt;fair&gt;.", "2 000 USD (2 teams)", "a talk", commitment, "Who is best?"):
        assert text in html, text
    for text in (
        "1 scored run at most",
        "2 attempts at most",
        "until 1 day after",
        "collected by the organizers",
        "Open",
    ):
        assert text in words(html), text
    closes = datetime.fromisoformat(stage["closes"])
    assert f'class="nowrap deadline" datetime="{closes:%Y-%m-%dT%H:%M:%SZ}"' in html
    assert re.search(r'closes in</dt><dd><span data-until="[^>]+>\d+ days \d+ h</span>', html), "without scripts"
    plain = shown(site, cup())
    for absent in ("/appeals", 'id="rules"', "Winners", "All announcements", "under random names"):
        assert absent not in plain


def test_what_closes_or_opens_next_is_counted_down_once_for_tracks_that_share_it(site: SeededSite) -> None:
    content = make_competition()
    first, second = content["tracks"][TRACK]["stages"]
    opens, closes = (datetime.fromisoformat(first[name]) for name in ("opens", "closes"))
    second |= {"opens": first["closes"], "closes": (closes + 9 * DAY).isoformat()}
    content["tracks"]["track_2"] = content["tracks"][TRACK] | {"title": "Sight"}
    site.hold(content)
    with site.database.reading() as session:
        view = competition_view(session)

    def shown_at(now: datetime) -> list[tuple[object, ...]]:
        return [(next_.tracks, next_.stage, next_.closes, next_.moment) for next_ in list_countdowns(view, now)]

    both = ("Touch", "Sight")
    assert shown_at(opens - DAY) == [(both, "Simulation", False, opens)]
    assert shown_at(opens) == [(both, "Simulation", True, closes)]
    assert shown_at(closes) == [(both, "Final", True, closes + 9 * DAY)]
    assert shown_at(closes + 9 * DAY) == []


def test_frozen_boards_hidden_names_and_the_newest_announcements_are_told(site: SeededSite) -> None:
    site.hold(cup(anonymous=True))
    with site.database.transaction() as session:
        freeze_boards(session, CONSOLE)
        for number in (1, 2, 3, 4):
            publish_announcement(session, CONSOLE, title=f"News <{number}>", text="All\nis well.", notify=False)
    html = site.visitor().get("/competition").text
    for text in ("News &lt;4&gt;", "News &lt;2&gt;", "All\nis well.", 'href="/announcements"', "under random names"):
        assert text in html, text
    assert "have been frozen since" in html
    assert "News &lt;1&gt;" not in html, "the others are on the page of announcements"


def test_winners_are_shown_at_the_end(site: SeededSite) -> None:
    site.hold(cup(prizes=FULL["prizes"], anonymous=True))
    site.score("A<b>", "won", 200)
    with site.database.transaction() as session:
        put_in_place(session, cup(days=-60, prizes=FULL["prizes"], anonymous=True))
        finalize(session, CONSOLE)
    html = site.visitor().get("/competition").text
    assert "A&lt;b&gt;" in html
    assert "Final since" in html
    for gone in ("data-until", "under random names"):
        assert gone not in html


def test_without_a_competition_there_is_no_page(browser: AsgiBrowser) -> None:
    assert browser.get("/competition").status_code == 404


def test_results_that_operators_enter_have_a_board_with_their_evidence(site: SeededSite) -> None:
    content = read_competition(EDITION_2026).model_dump(mode="json")
    site.hold(open_now(content, 1, "real_robot"))
    with site.database.transaction() as session:
        stage = Competition.read(session).stage("real_robot", "stage2")
        for name, points in (("ours <b>", (200, 140)), ("theirs", (420, 280))):
            entered_results.enter(
                session, CONSOLE, stage, team=None, baseline=name, attempt=1, evidence="https://example.org/a.mp4 film",
                points={"test_tube": points[0], "grinding": points[1]},
            )  # fmt: skip
    html = shown(site, content)
    text = words(html)
    assert "a brief of 2 to 4 pages as PDF" in text
    assert "every team whose brief of the stage before the committee accepts" in text
    assert "“Grind the named material with the pestle.”" in text
    assert text.index("theirs baseline 420 280 700 1 of 1") < text.index("baseline 200 140 340 1 of 1")
    assert "ours &lt;b&gt;" in html
    assert 'href="https://example.org/a.mp4"' in html
    assert "collected by the organizers" not in text
