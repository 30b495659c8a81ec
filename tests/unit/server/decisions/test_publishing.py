import csv
import json
from datetime import UTC, datetime

import pytest
from service_factories import LOCK, TASK, TRACK, make_principal, make_score, submit_scored
from submission_steps import refused
from vitac.server.database.engine import Database
from vitac.server.decisions.finishing import finalize
from vitac.server.decisions.publishing import result_files
from vitac.server.errors import ProblemCode
from vitac.server.principals import CONSOLE

from competitions import make_competition, moved, open_now, put_in_place

NASTY = ["=HYPERLINK(1)", "<script>alert(1)</script>", "Plain"]


@pytest.fixture
def files(database: Database) -> dict[str, str]:
    """The published files of a competition with three teams, two of which chose their names badly."""
    content = make_competition(prizes=[{"place": "first", "amount": 2000, "winners": 2, "note": "a talk"}])
    del content["tracks"][TRACK]["stages"][1]
    with database.transaction() as session:
        put_in_place(session, open_now(content))
        for number, name in enumerate(NASTY):
            team = make_principal(session, name)
            submit_scored(session, team, name, {TASK: make_score(50 - number)})
        written = dict(result_files(session))
    assert set(written) == {"results.json", "results.csv", "results.html", "certificates.html"}
    return written


def test_the_json_has_rules_winners_and_boards(files: dict[str, str]) -> None:
    found = json.loads(files["results.json"])
    assert (found["competition"]["name"], found["is_final"]) == ("cup", False)
    assert [winner["team"] for winner in found["winners"]] == NASTY[:2]
    assert [entry["team"] for entry in found["boards"][0]["entries"]] == NASTY


def test_a_spreadsheet_runs_nothing_of_a_name(files: dict[str, str]) -> None:
    rows = list(csv.DictReader(files["results.csv"].splitlines()))
    assert [row["team"] for row in rows] == ["'=HYPERLINK(1)", NASTY[1], "Plain"]
    assert [row["rank"] for row in rows] == ["1", "2", "3"]
    assert [(row["success_rate"], row["mean_steps"]) for row in rows[:2]] == [("0.25", ""), ("0.245", "")]
    assert all(len(row["result_hash"]) == 64 for row in rows)


def test_what_was_played_on_a_twin_says_so(database: Database) -> None:
    content = make_competition(prizes=[{"place": "first", "amount": 2000}])
    del content["tracks"][TRACK]["stages"][1]
    with database.transaction() as session:
        put_in_place(session, open_now(content))
        for name, twins in (("Ants", {"a twin of class B": 3}), ("Bees", {})):
            score = make_score(50 if twins else 20).model_copy(update={"twins": twins})
            submit_scored(session, make_principal(session, name), name, {TASK: score})
        files = result_files(session)
    rows = list(csv.DictReader(files["results.csv"].splitlines()))
    assert [(row["team"], row["twin_trials"]) for row in rows] == [("Ants", "3"), ("Bees", "0")]
    sentence = "Played on twins: 3 of 100 trials on a twin of class B."
    assert f"<strong>Ants: {sentence}</strong>" in files["results.html"]
    assert files["certificates.html"].count(f"<strong>{sentence}</strong>") == 1
    assert "Bees: Played" not in files["results.html"]


@pytest.mark.parametrize("name", ["results.html", "certificates.html"])
def test_pages_show_names_as_text(files: dict[str, str], name: str) -> None:
    assert "<script>" not in files[name]
    assert "&lt;script&gt;alert(1)&lt;/script&gt;" in files[name]
    assert "http" not in files[name]  # complete without the network


def test_the_page_says_that_it_is_not_final_and_each_winner_has_a_certificate(files: dict[str, str]) -> None:
    assert "Not final" in files["results.html"]
    assert files["certificates.html"].count("Not final: results may still change.") == 2
    assert "Touch, Simulation" in files["results.html"], "a stage is called by its title"
    assert files["certificates.html"].count('class="certificate"') == 2
    assert "a talk" in files["certificates.html"]
    assert "Plain" not in files["certificates.html"]


def test_a_certificate_says_by_what_its_board_was_won(database: Database) -> None:
    ranking = ["mean_steps", "success_rate", "submitted_at"]
    content = make_competition(prizes=[{"place": "first", "amount": 2000}], ranking=ranking)
    del content["tracks"][TRACK]["stages"][1]
    with database.transaction() as session:
        put_in_place(session, open_now(content))
        for team, solved, mean_steps in (("Ants", 90, 9.0), ("Bees", 50, 3.5)):
            scores = dict.fromkeys((TASK, LOCK), make_score(solved, mean_steps=mean_steps))
            submit_scored(session, make_principal(session, team), team, scores)
        page = result_files(session)["certificates.html"]
    assert "<h2>Bees</h2>" in page
    assert "<p>mean env steps: 3.5</p>" in page
    assert "50.0 %" not in page


def test_what_is_final_has_its_date(database: Database) -> None:
    content = make_competition(prizes=[{"place": "first", "amount": 2000}])
    del content["tracks"][TRACK]["stages"][1]
    with database.transaction() as session:
        put_in_place(session, open_now(content))
        submit_scored(session, make_principal(session, "Ants"), "ants", {TASK: make_score(50)})
        put_in_place(session, moved(content, days=-3650))
        finalize(session, CONSOLE, at=datetime(2031, 3, 1, 23, 59, tzinfo=UTC))
        found = result_files(session)
    assert json.loads(found["results.json"])["is_final"] is True
    assert "Final results of 2031-03-01." in found["results.html"]
    assert "<p>final since 2031-03-01</p>" in found["certificates.html"]
    for name in ("results.html", "certificates.html"):
        assert "Not final" not in found[name]
    assert "size: A4 landscape" in found["certificates.html"]
    assert "size: A4 landscape" not in found["results.html"]


def test_without_a_competition_there_are_no_results(database: Database) -> None:
    with refused(ProblemCode.NOT_FOUND), database.transaction() as session:
        result_files(session)
