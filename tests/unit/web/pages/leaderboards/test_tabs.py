"""Boards of stages: under the stage's title and one link from each other; a stage's submissions lead to its board."""

from datetime import UTC, datetime, timedelta

import pytest
from asgi_browser import AsgiBrowser
from page_fixtures import LOCK, TASK, a_finished_cup, a_leaderboard, a_log, a_submission
from page_service import FixedData
from visits import sign_in
from vitac.evaluator.logs.findings import VerificationResult
from vitac.server.database.states import EvaluationState
from vitac.server.views.competition import CompetitionView, StageView
from vitac.web.pages.leaderboards.tabs import find_stage_title, stage_tabs

DAY = timedelta(days=1)
NOW = datetime.now(UTC)


def stages() -> list[StageView]:
    """One that is over, one that is open, and one that opens tomorrow."""
    made = a_finished_cup().tracks[0].stages[0]
    names = {"first": -9, "final+": -1, "encore": 1}
    return [
        made.model_copy(update={"name": name, "title": f"The <{name}>", "opens": NOW + days * DAY})
        for name, days in names.items()
    ]


def a_cup() -> CompetitionView:
    cup = a_finished_cup()
    return cup.model_copy(update={"tracks": [cup.tracks[0].model_copy(update={"stages": stages()})]})


def shown(browser: AsgiBrowser, path: str) -> str:
    """The tabs of the stages on a page."""
    html = browser.get(path).text
    return html.partition('aria-label="Stages"')[2].partition("</nav>")[0]


def test_boards_of_opened_stages_are_one_link_away() -> None:
    tabs = stage_tabs(stages(), "final+", lambda name: f"?{name}")
    assert [(tab.title, tab.target, tab.current) for tab in tabs] == [
        ("The <first>", "?first", False),
        ("The <final+>", "?final+", True),
    ]
    assert [tab.title for tab in stage_tabs(stages(), "encore", str)][-1] == "The <encore>", "what is shown is named"
    assert stage_tabs(stages()[:1], "first", str) == ()
    assert stage_tabs((), None, str) == ()


def test_a_stage_is_called_by_its_title() -> None:
    assert find_stage_title(stages(), "first") == "The <first>"
    assert find_stage_title(stages(), "lost") == "lost"
    assert find_stage_title((), None) is None


@pytest.mark.parametrize(("page", "asked"), [("/tracks/track_1", f"task={TASK}&amp;"), ("/tracks/track_1/logs", "")])
def test_a_board_names_its_stage_and_leads_to_the_others(
    data: FixedData, browser: AsgiBrowser, page: str, asked: str
) -> None:
    data.cup = a_cup()
    data.task_boards[TASK] = a_leaderboard(task=TASK)
    query = f"{asked}stage=final%2B".replace("&amp;", "&")
    tabs = shown(browser, f"{page}?{query}")
    assert f'<a href="{page}?{asked}stage=first">The &lt;first&gt;</a>' in tabs
    assert f'<a href="{page}?{asked}stage=final%2B" aria-current="page">The &lt;final+&gt;</a>' in tabs
    assert "encore" not in tabs, "nobody is on that board yet"
    assert '<a href="/competition">The &lt;final+&gt;</a>' in browser.get(f"{page}?{query}").text
    data.cup = None
    assert shown(browser, page) == ""


def test_the_schedule_leads_to_the_boards_of_opened_stages(data: FixedData, browser: AsgiBrowser) -> None:
    data.cup = a_cup()
    html = browser.get("/competition").text
    assert '<a href="/tracks/track_1?stage=final%2B">The &lt;final+&gt;</a>' in html
    assert "stage=encore" not in html
    assert "sealed list of The &lt;first&gt;:" in html
    elsewhere = data.cup.tracks[0].model_copy(update={"taken_here": False})
    data.cup = data.cup.model_copy(update={"tracks": [elsewhere]})
    assert "?stage=" not in browser.get("/competition").text


def test_a_submission_names_its_stage_and_leads_to_its_board(data: FixedData, browser: AsgiBrowser) -> None:
    data.cup = a_cup()
    model = a_submission("Gelbots", EvaluationState.COMPLETED, name="staged", tasks=(TASK, LOCK))
    log = a_log(EvaluationState.COMPLETED, VerificationResult.VERIFIED)
    data.found += [one.model_copy(update={"stage": "final+"}) for one in (model, log)]
    sign_in(browser, "Gelbots")
    html = browser.get(f"/submissions/{model.id}").text
    assert '<a href="/tracks/track_1?stage=final%2B">The &lt;final+&gt;</a>' in html
    assert 'on the <a href="/tracks/track_1?stage=final%2B">leaderboard</a>' in html
    assert f'href="/tracks/track_1?task={LOCK}&amp;stage=final%2B">1 of 3</a>' in html
    assert 'href="/tracks/track_1/logs?stage=final%2B"' in browser.get(f"/submissions/{log.id}").text
    practice = browser.get(f"/submissions/{data.found[1].id}").text
    assert f'on the <a href="/tracks/track_1?task={TASK}">leaderboard</a> of Peg insertion.' in practice
    assert "stage=" not in practice
