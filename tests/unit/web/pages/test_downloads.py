import csv
import io
import json

import pytest
from asgi_browser import AsgiBrowser
from page_fixtures import LOCK, TASK, FixedData, a_leaderboard, a_score, an_entry, some_episodes
from visits import BOTH, COMPLETED, QUEUED, sign_in

SCORE = a_score((80, 74, 80), 4.92)


def rows_of(text: str) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(text)))


def test_a_board_is_a_file_with_a_row_for_each_entry(data: FixedData, browser: AsgiBrowser) -> None:
    data.board = a_leaderboard(
        an_entry(1, '=HYPERLINK("evil")', SCORE, name="@cmd"), an_entry(None, 'Comma, "quoted"\nline', SCORE)
    )
    answer = browser.get("/tracks/track_1/leaderboard.csv")
    assert answer.headers["content-type"].startswith("text/csv")
    assert answer.headers["content-disposition"] == 'attachment; filename="track_1-all.csv"'
    first, second = rows_of(answer.text)
    assert (first["rank"], first["team"], first["submission"]) == ("1", '\'=HYPERLINK("evil")', "'@cmd")
    assert (second["rank"], second["team"], second["mean_env_steps"]) == ("", 'Comma, "quoted"\nline', "")
    assert float(first["interval_low"]) < float(first["success_rate"]) < float(first["interval_high"])


def test_a_board_of_a_task_is_named_by_it(data: FixedData, browser: AsgiBrowser) -> None:
    data.task_boards = {TASK: a_leaderboard(an_entry(1, "Gelbots", SCORE, task=TASK), task=TASK)}
    answer = browser.get(f"/tracks/track_1/leaderboard.csv?task={TASK}")
    assert f"track_1-{TASK}.csv" in answer.headers["content-disposition"]
    assert rows_of(answer.text)[0]["mean_env_steps"] == "4.92"
    assert browser.get("/tracks/track_1/leaderboard.csv?task=none").status_code == 404


def test_episodes_are_the_same_as_csv_and_json(browser: AsgiBrowser) -> None:
    sign_in(browser, "Gelbots")
    path = f"/submissions/{BOTH.id}/episodes"
    as_csv, as_json = rows_of(browser.get(f"{path}.csv").text), json.loads(browser.get(f"{path}.json").text)
    ends = some_episodes(TASK, 270) + some_episodes(LOCK, 160)
    assert len(as_csv) == len(as_json) == len(ends)
    assert [{key: str(value) for key, value in row.items()} for row in as_json] == as_csv
    first = as_json[0]
    assert (first["task"], first["episode"], first["outcome"]) == (TASK, 1, ends[0].outcome)
    assert as_csv[0]["start"].startswith("-4 ")  # numbers are no formula


def test_a_stages_own_list_keeps_its_starts(data: FixedData, browser: AsgiBrowser) -> None:
    evaluation = COMPLETED.evaluation.model_copy(update={"commitment": "c0ffee"})
    data.found = [COMPLETED.model_copy(update={"evaluation": evaluation})]
    sign_in(browser, "Gelbots")
    rows = rows_of(browser.get(f"/submissions/{COMPLETED.id}/episodes.csv").text)
    assert {row["start"] for row in rows} == {""}


@pytest.mark.parametrize("name", ["episodes.csv", "episodes.json", "compare", "compare.csv"])
def test_they_are_for_the_team_only(browser: AsgiBrowser, name: str) -> None:
    assert browser.get(f"/submissions/{COMPLETED.id}/{name}").status_code == 303
    sign_in(browser, "Gelbots")
    assert browser.get(f"/submissions/{QUEUED.id}/{name}").status_code == 404


@pytest.mark.parametrize("name", ["episodes.csv", "episodes.json"])
def test_only_the_usual_form_of_an_id_is_read(browser: AsgiBrowser, name: str) -> None:
    sign_in(browser, "Gelbots")
    shown = str(COMPLETED.id)
    arabic_digits = shown.translate({ord("0") + digit: 0x660 + digit for digit in range(10)})
    for other in (arabic_digits, f"{{{shown}}}", f"urn:uuid:{shown}", COMPLETED.id.hex):
        assert browser.get(f"/submissions/{other}/{name}").status_code == 404
    answer = browser.get(f"/submissions/{shown.upper()}/{name}")
    assert f'filename="{shown}-episodes.' in answer.headers["content-disposition"]


def test_pages_link_to_the_files(data: FixedData, browser: AsgiBrowser) -> None:
    data.board = a_leaderboard(an_entry(1, "Gelbots", SCORE))
    board = browser.get("/tracks/track_1").text
    assert 'href="/tracks/track_1/leaderboard.csv"' in board
    assert 'href="/api/v1/leaderboards/track_1"' in board
    sign_in(browser, "Gelbots")
    page = browser.get(f"/submissions/{COMPLETED.id}").text
    assert f'href="/submissions/{COMPLETED.id}/episodes.csv"' in page
    assert f'href="/submissions/{COMPLETED.id}/compare"' in page
