"""Boards of stages: under the stage's title and one link from each other; a stage's submissions lead to its board."""

from datetime import UTC, datetime, timedelta
from typing import Any

import pytest
from seeded_site import BOTH, GELBOTS, SeededSite, words
from service_factories import LOCK, TASK, TRACK
from vitac.server.views.competition import StageView
from vitac.web.pages.leaderboards import find_stage_title, stage_tabs

from competitions import make_competition

DAY = timedelta(days=1)
NOW = datetime.now(UTC)


def cup() -> dict[str, Any]:
    """A competition with a stage that is over, one that is open, and one that opens tomorrow."""
    content = make_competition(appeal_days=7)
    first = content["tracks"][TRACK]["stages"][0]
    content["tracks"][TRACK]["stages"] = [
        first
        | {
            "name": name,
            "title": f"The <{name}>",
            "opens": (NOW + opens * DAY).isoformat(),
            "closes": (NOW + (opens + days) * DAY).isoformat(),
        }
        for name, opens, days in (("first", -9, 8), ("final", -1, 2), ("encore", 1, 1))
    ]
    return content


def stages() -> list[StageView]:
    empty: dict[str, Any] = dict.fromkeys(("list_kind", "commitment", "secret", "scored_runs", "attempts", "qualified"))
    shown = ("name", "title", "opens", "closes", "accepts")
    return [
        StageView.model_validate(empty | {"is_open": False} | {key: stage[key] for key in shown})
        for stage in cup()["tracks"][TRACK]["stages"]
    ]


def test_boards_of_opened_stages_are_one_link_away() -> None:
    tabs = stage_tabs(stages(), "final", lambda name: f"?{name}")
    assert [(tab.title, tab.target, tab.current) for tab in tabs] == [
        ("The <first>", "?first", False),
        ("The <final>", "?final", True),
    ]
    assert [tab.title for tab in stage_tabs(stages(), "encore", str)][-1] == "The <encore>", "what is shown is named"
    assert stage_tabs(stages()[:1], "first", str) == ()
    assert stage_tabs((), None, str) == ()


def test_a_stage_is_called_by_its_title() -> None:
    assert find_stage_title(stages(), "first") == "The <first>"
    assert find_stage_title(stages(), "lost") == "lost"
    assert find_stage_title((), None) is None


@pytest.mark.parametrize(("page", "asked"), [("/tracks/track_1", f"task={TASK}&amp;"), ("/tracks/track_1/logs", "")])
def test_a_board_names_its_stage_and_leads_to_the_others(site: SeededSite, page: str, asked: str) -> None:
    assert 'aria-label="Stages"' not in site.visitor().get(page).text
    site.hold(cup())
    html = site.visitor().get(f"{page}?{asked}stage=final".replace("&amp;", "&")).text
    tabs = html.partition('aria-label="Stages"')[2].partition("</nav>")[0]
    assert f'<a href="{page}?{asked}stage=first">The &lt;first&gt;</a>' in tabs
    assert f'<a href="{page}?{asked}stage=final" aria-current="page">The &lt;final&gt;</a>' in tabs
    assert "encore" not in tabs, "nobody is on that board yet"
    assert '<a href="/competition">The &lt;final&gt;</a>' in html


def test_the_schedule_leads_to_the_boards_of_opened_stages(site: SeededSite) -> None:
    site.hold(cup())
    html = site.visitor().get("/competition").text
    assert '<a href="/tracks/track_1?stage=final">The &lt;final&gt;</a>' in html
    assert "stage=encore" not in html
    elsewhere = cup()
    elsewhere["tracks"][TRACK]["taken_here"] = False
    site.hold(elsewhere)
    assert "?stage=" not in site.visitor().get("/competition").text


def test_a_submission_names_its_stage_leads_to_its_board_and_offers_an_appeal(site: SeededSite) -> None:
    browser = site.visitor(GELBOTS)
    assert 'on the <a href="/tracks/track_1">leaderboard</a>' in browser.get(site.path_of("both")).text
    site.hold(cup())
    html = browser.get(site.submit(GELBOTS, "staged", BOTH)).text
    assert '<a href="/tracks/track_1?stage=final">The &lt;final&gt;</a>' in html
    assert 'on the <a href="/tracks/track_1?stage=final">leaderboard</a>' in html
    assert f'href="/tracks/track_1?task={LOCK}&amp;stage=final">1 of 1</a>' in html
    assert "Rank 1 of 1" in words(html)
    assert "/appeals?submission=" in html
