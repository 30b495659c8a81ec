import csv
import io
import json
from datetime import UTC, datetime
from typing import Any

import pytest
from asgi_browser import AsgiBrowser
from seeded_site import BEARS, DONE, GELBOTS, SeededSite
from service_factories import LOCK, TASK, forget_boards
from sqlalchemy import update
from vitac.server.csv_text import csv_text
from vitac.server.database.models import Submission, Team
from vitac.server.leaderboards.public_pages import set_public
from vitac.web.pages.files import TableFormat, objects, table_file


@pytest.mark.parametrize("text", ["=1+1", "+1+1", "-1+cmd", "@SUM(A1)", "\tx", "\rx", "-", "+", "-1 =x"])
def test_a_text_that_a_spreadsheet_would_run_gets_an_apostrophe(text: str) -> None:
    assert next(csv.reader(io.StringIO(csv_text([(text,)]), newline=""))) == [f"'{text}"]


@pytest.mark.parametrize("cell", ["-4 2 0.5", "-1", -4.5, "plain", "a=b", 3])
def test_numbers_and_plain_texts_stay(cell: object) -> None:
    assert next(csv.reader(io.StringIO(csv_text([(cell,)])))) == [str(cell)]


def test_what_is_missing_is_an_empty_cell_and_null() -> None:
    columns, rows = ("a", "b"), [(None, 'x, "y"\nz')]
    as_csv, as_json = (table_file(form, "name", columns, rows) for form in (TableFormat.CSV, TableFormat.JSON))
    assert list(csv.DictReader(io.StringIO(bytes(as_csv.body).decode(), newline=""))) == [{"a": "", "b": 'x, "y"\nz'}]
    assert json.loads(bytes(as_json.body)) == [{"a": None, "b": 'x, "y"\nz'}]
    for answer, form in ((as_csv, "csv"), (as_json, "json")):
        assert answer.headers["content-disposition"] == f'attachment; filename="name.{form}"'
        assert answer.headers["cache-control"] == "no-store"


def test_a_row_of_another_length_is_refused() -> None:
    with pytest.raises(ValueError, match="zip"):
        objects(("a", "b"), [(datetime.now(UTC),)])


def make_rows(text: str) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(text)))


def test_a_board_is_a_file_with_a_row_for_each_entry_and_no_formula(site: SeededSite) -> None:
    with site.database.transaction() as session:
        session.execute(update(Team).where(Team.name == GELBOTS).values(name='=HYPERLINK("evil")'))
        session.execute(update(Submission).where(Submission.name == "both").values(name="@cmd"))
        session.execute(update(Team).where(Team.name == "Bears").values(name='Comma, "quoted"\nline'))
    forget_boards()
    answer = site.visitor().get("/tracks/track_1/leaderboard.csv")
    assert answer.headers["content-type"].startswith("text/csv")
    assert answer.headers["content-disposition"] == 'attachment; filename="track_1-all.csv"'
    first, second = make_rows(answer.text)
    assert (first["rank"], first["team"], first["submission"]) == ("1", '\'=HYPERLINK("evil")', "'@cmd")
    assert (second["rank"], second["team"]) == ("2", 'Comma, "quoted"\nline')
    assert float(first["interval_low"]) < float(first["success_rate"]) < float(first["interval_high"])


def test_a_board_of_a_task_is_named_by_it_and_pages_link_to_their_files(browser: AsgiBrowser) -> None:
    answer = browser.get(f"/tracks/track_1/leaderboard.csv?task={TASK}")
    assert f"track_1-{TASK}.csv" in answer.headers["content-disposition"]
    assert [row["team"] for row in make_rows(answer.text)] == ["Bears", GELBOTS]
    assert browser.get("/tracks/track_1/leaderboard.csv?task=none").status_code == 404
    board = browser.get("/tracks/track_1").text
    assert 'href="/tracks/track_1/leaderboard.csv"' in board
    assert 'href="/api/v1/leaderboards/track_1"' in board


TABLES = ("episodes", "scores", "history")


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
