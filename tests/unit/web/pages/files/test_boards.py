import csv
import io

from asgi_browser import AsgiBrowser
from page_fixtures import TASK, a_leaderboard, a_score, an_entry
from page_service import FixedData

SCORE = a_score((80, 74, 80), 4.92)


def make_rows(text: str) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(text)))


def test_a_board_is_a_file_with_a_row_for_each_entry(data: FixedData, browser: AsgiBrowser) -> None:
    data.board = a_leaderboard(
        an_entry(1, '=HYPERLINK("evil")', SCORE, name="@cmd"), an_entry(None, 'Comma, "quoted"\nline', SCORE)
    )
    answer = browser.get("/tracks/track_1/leaderboard.csv")
    assert answer.headers["content-type"].startswith("text/csv")
    assert answer.headers["content-disposition"] == 'attachment; filename="track_1-all.csv"'
    first, second = make_rows(answer.text)
    assert (first["rank"], first["team"], first["submission"]) == ("1", '\'=HYPERLINK("evil")', "'@cmd")
    assert (second["rank"], second["team"], second["mean_env_steps"]) == ("", 'Comma, "quoted"\nline', "")
    assert float(first["interval_low"]) < float(first["success_rate"]) < float(first["interval_high"])


def test_a_board_of_a_task_is_named_by_it(data: FixedData, browser: AsgiBrowser) -> None:
    data.task_boards = {TASK: a_leaderboard(an_entry(1, "Gelbots", SCORE, task=TASK), task=TASK)}
    answer = browser.get(f"/tracks/track_1/leaderboard.csv?task={TASK}")
    assert f"track_1-{TASK}.csv" in answer.headers["content-disposition"]
    assert make_rows(answer.text)[0]["mean_env_steps"] == "4.92"
    assert browser.get("/tracks/track_1/leaderboard.csv?task=none").status_code == 404


def test_verified_logs_are_a_file_with_their_verification_and_whose_copies_they_are(browser: AsgiBrowser) -> None:
    answer = browser.get("/tracks/track_1/logs.csv?stage=final")
    assert "track_1-final-logs.csv" in answer.headers["content-disposition"]
    own, copy = make_rows(answer.text)
    assert (own["task"], own["rank"], own["team"], own["verification"]) == (TASK, "1", "Gelbots", "verified")
    assert (own["copy_of_team"], own["copied_episodes"], own["successes"]) == ("", "", "243")
    assert (copy["copy_of_team"], copy["copied_episodes"]) == ("Gelbots", "200")
    assert float(copy["success_rate"]) == 40 / 270


def test_text_logs_are_a_file_beside_their_claims(data: FixedData, browser: AsgiBrowser) -> None:
    hostile = data.logs.text_logs[0].model_copy(update={"team": "=1+1", "claimed_mean_steps": None})
    data.logs = data.logs.model_copy(update={"text_logs": [hostile, *data.logs.text_logs]})
    answer = browser.get("/tracks/track_1/text-logs.csv")
    assert "track_1-text-logs.csv" in answer.headers["content-disposition"]
    first, second = make_rows(answer.text)
    assert (first["team"], first["claimed_mean_env_steps"]) == ("'=1+1", "")
    assert (second["claimed_success_rate"], second["success_rate"], second["problems"]) == ("0.9063", "0.85", "1")


def test_pages_link_to_the_files_of_their_stage(data: FixedData, browser: AsgiBrowser) -> None:
    data.board = a_leaderboard(an_entry(1, "Gelbots", SCORE))
    board = browser.get("/tracks/track_1").text
    assert 'href="/tracks/track_1/leaderboard.csv"' in board
    assert 'href="/api/v1/leaderboards/track_1"' in board
    logs = browser.get("/tracks/track_1/logs?stage=final").text
    for file in ("/tracks/track_1/logs.csv", "/tracks/track_1/text-logs.csv", "/api/v1/leaderboards/track_1/logs"):
        assert f'href="{file}?stage=final"' in logs
