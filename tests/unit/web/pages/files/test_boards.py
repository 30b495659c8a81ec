import csv
import io

from asgi_browser import AsgiBrowser
from seeded_site import GELBOTS, SeededSite
from service_factories import TASK, forget_boards
from sqlalchemy import update
from vitac.server.database.models import Submission, Team


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
