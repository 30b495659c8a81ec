import csv
import io
import json
from typing import Any

import pytest
from asgi_browser import AsgiBrowser
from seeded_site import BEARS, DONE, GELBOTS, SeededSite
from service_factories import LOCK, TASK
from vitac.server.database.models import Submission
from vitac.server.leaderboards.public_pages import set_public

TABLES = ("episodes", "scores", "history")


def make_rows(text: str) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(text)))


def both_forms(browser: AsgiBrowser, path: str, table: str) -> tuple[list[dict[str, str]], list[Any]]:
    as_csv, as_json = browser.get(f"{path}/{table}.csv"), browser.get(f"{path}/{table}.json")
    assert f'filename="{path.rpartition("/")[2]}-{table}.csv"' in as_csv.headers["content-disposition"]
    return make_rows(as_csv.text), json.loads(as_json.text)


def as_texts(rows: list[dict[str, Any]]) -> list[dict[str, str]]:
    return [{key: "" if value is None else str(value) for key, value in row.items()} for row in rows]


def test_episodes_are_the_same_as_csv_and_json(site: SeededSite) -> None:
    as_csv, as_json = both_forms(site.visitor(GELBOTS), site.path_of("both"), "episodes")
    assert len(as_csv) == 270 + 160
    assert as_texts(as_json) == as_csv
    first = next(row for row in as_csv if row["task"] == TASK)
    assert (first["episode"], first["outcome"]) == ("1", "success")
    assert first["start"].startswith("-4 ")  # numbers are no formula


def test_a_stages_own_list_keeps_its_starts(site: SeededSite) -> None:
    path = site.submit(GELBOTS, "sealed", DONE)
    site.seal("sealed", is_revealed=True)
    rows, _ = both_forms(site.visitor(GELBOTS), path, "episodes")
    assert (len(rows), {row["start"] for row in rows}) == (270, {""})


def test_scores_have_a_row_for_each_task_and_each_of_its_shapes(site: SeededSite) -> None:
    browser = site.visitor(GELBOTS)
    as_csv, as_json = both_forms(browser, site.path_of("both"), "scores")
    assert as_texts(as_json) == as_csv
    assert [row["task"] for row in as_json] == [TASK] * 4 + [LOCK] * 5
    whole = as_json[0]
    assert (whole["shape"], whole["successes"], whole["mean_env_steps"]) == (None, 234, pytest.approx(4.5, abs=0.01))
    cuboid = next(row for row in as_json if row["shape"] == "cuboid")
    assert (cuboid["successes"], cuboid["mean_env_steps"]) == (80, None)
    assert all(row["interval_low"] < row["success_rate"] <= row["interval_high"] for row in as_json)
    assert both_forms(browser, site.path_of("runs"), "scores") == ([], [])


def test_the_history_is_a_file_and_linked_where_it_is_shown(site: SeededSite) -> None:
    path, browser = site.path_of("done"), site.visitor(GELBOTS)
    with site.database.transaction() as session:
        set_public(session, site.seed.people[GELBOTS], site.id_of("done"), public=True)
        session.get_one(Submission, site.id_of("both")).name = "=new"
    assert "history.csv" not in site.visitor().get(path).text
    assert both_forms(site.visitor(), path, "history") == ([], []), "a visitor sees nothing of it"
    as_csv, as_json = both_forms(browser, path, "history")
    assert sorted(row["submission"] for row in as_csv) == ["'=new", "done"]
    assert sorted(row["submission"] for row in as_json) == ["=new", "done"], "nothing runs a formula in JSON"
    assert {row["ranked_by"] for row in as_json} == {"success_rate"}
    assert all(row["value"] == row["success_rate"] for row in as_json)
    html = browser.get(path).text
    for table in TABLES:
        for form in ("csv", "json"):
            assert f'href="{path}/{table}.{form}"' in html


@pytest.mark.parametrize("name", [f"{table}.{form}" for table in TABLES for form in ("csv", "json")])
def test_they_are_for_the_team_only(site: SeededSite, name: str) -> None:
    assert site.visitor().get(f"{site.path_of('done')}/{name}").status_code == 303
    assert site.visitor(BEARS).get(f"{site.path_of('done')}/{name}").status_code == 404


def test_only_the_usual_form_of_an_id_is_read(site: SeededSite) -> None:
    browser, shown = site.visitor(GELBOTS), str(site.id_of("done"))
    arabic_digits = shown.translate({ord("0") + digit: 0x660 + digit for digit in range(10)})
    for other in (arabic_digits, f"{{{shown}}}", f"urn:uuid:{shown}", shown.replace("-", "")):
        assert browser.get(f"/submissions/{other}/episodes.csv").status_code == 404
    answer = browser.get(f"/submissions/{shown.upper()}/episodes.csv")
    assert f'filename="{shown}-episodes.' in answer.headers["content-disposition"]


def test_the_list_is_a_file_with_a_row_for_each_task(site: SeededSite) -> None:
    assert site.visitor().get("/submissions.csv").status_code == 303
    browser = site.visitor(GELBOTS)
    assert 'href="/submissions.csv"' in browser.get("/submissions").text
    answer = browser.get("/submissions.csv")
    assert answer.headers["content-disposition"] == 'attachment; filename="submissions.csv"'
    runs, broke, done, *both = make_rows(answer.text)
    assert [(row["submission"], row["task"]) for row in both] == [("both", TASK), ("both", LOCK)]
    assert (runs["state"], runs["episodes_done"], runs["success_rate"]) == ("running", "137", "")
    assert (done["state"], done["episodes_total"], done["team"]) == ("completed", "270", GELBOTS)
    assert float(done["mean_env_steps"]) == pytest.approx(4.5, abs=0.01)
    assert (broke["submission"], broke["state"]) == ("broke", "failed")
