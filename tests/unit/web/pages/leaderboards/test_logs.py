import re

import pytest
from asgi_browser import AsgiBrowser
from page_fixtures import LOCK, TASK, a_log_entry, an_id
from page_service import FixedData
from visits import sign_in
from vitac.evaluator.logs.findings import VerificationResult

TEAMS = [f"Team {place:03d}" for place in range(1, 61)] + ["Gelbots"]


@pytest.fixture
def many(data: FixedData) -> FixedData:
    """61 verified logs of the peg task and 61 text logs; the Gelbots' are the last."""
    entries = [a_log_entry(place, team, 243, VerificationResult.VERIFIED) for place, team in enumerate(TEAMS, start=1)]
    text_logs = [
        data.logs.text_logs[0].model_copy(
            update={"team": team, "evaluation_id": an_id(f"text {team}"), "submission_name": f"text of {team}"}
        )
        for team in TEAMS
    ]
    boards = [board.model_copy(update={"entries": entries if board.task == TASK else []}) for board in data.logs.boards]
    data.logs = data.logs.model_copy(update={"boards": boards, "text_logs": text_logs})
    return data


def section(html: str, name: str) -> str:
    found = re.search(rf'<section aria-labelledby="{name}">.*?</section>', html, re.DOTALL)
    assert found is not None
    return found[0]


def test_each_board_has_pages_of_its_own(many: FixedData, browser: AsgiBrowser) -> None:
    html = browser.get("/tracks/track_1/logs?stage=final&page-text-logs=3").text
    peg, text_logs = section(html, f"logs-{TASK}"), section(html, "text-logs")
    assert peg.count('<tr role="row" class') == 25
    assert "Team 001" in peg
    assert f'href="/tracks/track_1/logs?stage=final&amp;page-logs-{TASK}=2#logs-{TASK}"' in peg
    assert text_logs.count('<tr role="row" class') == 11
    assert "Team 051" in text_logs
    assert 'href="/tracks/track_1/logs?stage=final&amp;page-text-logs=3#text-logs" aria-current="page"' in text_logs
    assert "No verified log of this task yet." in section(html, f"logs-{LOCK}")
    assert '<input type="hidden" name="stage" value="final">' in html
    assert many.logs.boards[0].task == TASK


def test_a_search_looks_through_all_boards(many: FixedData, browser: AsgiBrowser) -> None:
    html = browser.get("/tracks/track_1/logs?q=team+05").text
    for name in (f"logs-{TASK}", "text-logs"):
        found = section(html, name)
        assert found.count('<tr role="row" class') == 10
        assert 'class="pages"' not in found
    nobody = browser.get("/tracks/track_1/logs?q=<b>").text
    assert "Entries with “<bdi>&lt;b&gt;</bdi>” in the name." in nobody
    assert nobody.count("matches the search") == 2
    assert len(many.logs.text_logs) == 61


def test_the_own_rows_are_marked_and_linked(many: FixedData, browser: AsgiBrowser) -> None:
    assert "Your team" not in browser.get("/tracks/track_1/logs").text
    sign_in(browser, "Gelbots")
    first = browser.get("/tracks/track_1/logs").text
    assert f'<a href="/tracks/track_1/logs?page-logs-{TASK}=3#logs-{TASK}">Your team</a>: rank 61' in first
    assert 'href="/tracks/track_1/logs?page-text-logs=3#text-logs">Your team’s newest one</a>' in first
    assert first.count('class="own"') == 0
    second = browser.get(f"/tracks/track_1/logs?page-logs-{TASK}=3&page-text-logs=3").text
    assert section(second, f"logs-{TASK}").count('class="own"') == 1
    assert section(second, "text-logs").count('class="own"') == 1
    assert many.logs.text_logs[-1].team == "Gelbots"


def test_a_few_logs_need_no_pages_and_no_search(browser: AsgiBrowser) -> None:
    html = browser.get("/tracks/track_1/logs").text
    assert 'role="search"' not in html
    assert 'class="pages"' not in html
