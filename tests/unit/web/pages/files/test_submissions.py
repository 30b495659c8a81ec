import csv
import io
import json
from typing import Any
from uuid import UUID

import page_service
import pytest
from asgi_browser import AsgiBrowser
from page_fixtures import LOCK, TASK, a_past_result, some_episodes
from page_service import FixedData
from visits import BEARS, BOTH, COMPLETED, FAILED, GELBOTS, QUEUED, RUNNING, sign_in
from vitac.server.principals import Principal
from vitac.server.views.submissions import SubmissionListView

TABLES = ("episodes", "scores", "history")


def make_rows(text: str) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(text)))


def both_forms(browser: AsgiBrowser, submission_id: UUID, table: str) -> tuple[list[dict[str, str]], list[Any]]:
    path = f"/submissions/{submission_id}/{table}"
    as_csv, as_json = browser.get(f"{path}.csv"), browser.get(f"{path}.json")
    assert f'filename="{submission_id}-{table}.csv"' in as_csv.headers["content-disposition"]
    return make_rows(as_csv.text), json.loads(as_json.text)


def as_text(value: object) -> str:
    return "" if value is None else str(value)


def test_episodes_are_the_same_as_csv_and_json(browser: AsgiBrowser) -> None:
    sign_in(browser, "Gelbots")
    as_csv, as_json = both_forms(browser, BOTH.id, "episodes")
    ends = some_episodes(TASK, 270) + some_episodes(LOCK, 160)
    assert len(as_csv) == len(as_json) == len(ends)
    assert [{key: "" if value is None else str(value) for key, value in row.items()} for row in as_json] == as_csv
    first = as_json[0]
    assert (first["task"], first["episode"], first["outcome"]) == (TASK, 1, ends[0].outcome)
    assert as_csv[0]["start"].startswith("-4 ")  # numbers are no formula


def test_a_stages_own_list_keeps_its_starts(data: FixedData, browser: AsgiBrowser) -> None:
    evaluation = COMPLETED.evaluation.model_copy(update={"commitment": "c0ffee"})
    data.found = [COMPLETED.model_copy(update={"evaluation": evaluation})]
    sign_in(browser, "Gelbots")
    rows, _ = both_forms(browser, COMPLETED.id, "episodes")
    assert {row["start"] for row in rows} == {""}


def test_scores_have_a_row_for_each_task_and_each_of_its_shapes(browser: AsgiBrowser) -> None:
    sign_in(browser, "Gelbots")
    as_csv, as_json = both_forms(browser, BOTH.id, "scores")
    assert [{key: as_text(value) for key, value in row.items()} for row in as_json] == as_csv
    assert [row["task"] for row in as_json] == [TASK] * 4 + [LOCK] * 5
    whole, first = as_json[:2]
    assert (whole["shape"], whole["successes"], whole["mean_env_steps"]) == (None, 234, 4.92)
    assert (first["shape"], first["successes"], first["mean_env_steps"]) == ("cuboid", 80, None)
    assert all(row["interval_low"] < row["success_rate"] <= row["interval_high"] for row in as_json)
    assert both_forms(browser, RUNNING.id, "scores") == ([], [])


def test_the_history_is_a_file_and_linked_where_it_is_shown(data: FixedData, browser: AsgiBrowser) -> None:
    data.past = [a_past_result("=new", 0.9, 1), a_past_result("old", 0.5, 9)]
    data.found = [found.model_copy(update={"public": True}) for found in data.found]
    path = f"/submissions/{COMPLETED.id}"
    assert "history.csv" not in browser.get(path).text
    assert both_forms(browser, COMPLETED.id, "history") == ([], []), "a visitor sees nothing of it"
    sign_in(browser, "Gelbots")
    as_csv, as_json = both_forms(browser, COMPLETED.id, "history")
    assert [(row["submission"], row["success_rate"]) for row in as_csv] == [("'=new", "0.9"), ("old", "0.5")]
    assert [row["submission"] for row in as_json] == ["=new", "old"], "nothing runs a formula in JSON"
    assert as_json[0]["submitted_at"] == data.past[0].submitted_at.isoformat()
    html = browser.get(path).text
    for table in TABLES:
        for form in ("csv", "json"):
            assert f'href="{path}/{table}.{form}"' in html


@pytest.mark.parametrize("name", [f"{table}.{form}" for table in TABLES for form in ("csv", "json")])
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


def test_the_list_is_a_file_with_a_row_for_each_task(data: FixedData, browser: AsgiBrowser) -> None:
    assert browser.get("/submissions.csv").status_code == 303
    sign_in(browser, "Gelbots")
    assert 'href="/submissions.csv"' in browser.get("/submissions").text
    answer = browser.get("/submissions.csv")
    assert answer.headers["content-disposition"] == 'attachment; filename="submissions.csv"'
    rows = make_rows(answer.text)
    assert [(row["submission"], row["task"]) for row in rows] == [
        (RUNNING.name, TASK), (COMPLETED.name, TASK), (BOTH.name, TASK), (BOTH.name, LOCK), (FAILED.name, TASK),
    ]  # fmt: skip
    assert (rows[0]["state"], rows[0]["episodes_done"], rows[0]["success_rate"]) == ("running", "137", "")
    assert (rows[1]["state"], rows[1]["episodes_total"], rows[1]["mean_env_steps"]) == ("completed", "270", "4.92")
    assert {row["team"] for row in rows} == {GELBOTS.team_name}
    data.found = []
    assert make_rows(browser.get("/submissions.csv").text) == []


def test_the_list_goes_on_to_the_oldest_submission(browser: AsgiBrowser, monkeypatch: pytest.MonkeyPatch) -> None:
    pages = {None: (RUNNING, RUNNING.id), RUNNING.id: (FAILED, FAILED.id), FAILED.id: (COMPLETED, None)}
    asked = []

    def submissions(
        _: FixedData, __: object, by: Principal, *, track: str | None = None, before: UUID | None = None
    ) -> Any:
        asked.append((by.team_name, before, track))
        item, next_before = pages[before]
        return SubmissionListView(items=[item], next_before=next_before)

    monkeypatch.setattr(page_service.FixedData, "submissions", submissions)
    sign_in(browser, "Bears")
    rows = make_rows(browser.get("/submissions.csv").text)
    assert [row["submission"] for row in rows] == [RUNNING.name, FAILED.name, COMPLETED.name]
    assert asked == [(BEARS.team_name, before, None) for before in pages]
