import csv
import json

import httpx
import pytest
from cli_service import CliService
from service_factories import TASK, make_principal, play_all, submit, successes_below
from vitac.cli.client import leaderboard


@pytest.fixture
def both(service: CliService) -> CliService:
    """Two teams on the board of a track, of which the second solves more episodes; neither is a copy."""
    with service.database.transaction() as session:
        first, second = (submit(session, make_principal(session, team), team) for team in ("Ants", "Bears & Co"))
    play_all(service.database, first, successes_below(100))
    play_all(service.database, second, successes_below(200))
    return service


def test_spreadsheet_has_what_the_page_gives_though_read_in_pages(
    both: CliService, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(leaderboard, "PAGE_ENTRIES", 1)
    done = both.run("leaderboard", "track_1", "--task", TASK, "--csv")
    rows = list(csv.DictReader(done.stdout.splitlines()))
    assert [row["team"] for row in rows] == ["Bears & Co", "Ants"]
    page = httpx.get(f"{both.address}/tracks/track_1/leaderboard.csv?task={TASK}", timeout=30)
    assert list(csv.DictReader(page.text.splitlines())) == rows


def test_table_for_latex_has_intervals_and_escapes_names(both: CliService) -> None:
    latex = both.run("leaderboard", "track_1", "--task", TASK, "--latex").stdout
    assert r"Bears \& Co & " in latex
    assert latex.count(" to ") >= 2
    assert latex.count(r"\end{tabular}") == 1


def test_examples_follow_without_a_rank(both: CliService) -> None:
    shown = both.run("leaderboard", "track_1", "--task", TASK).stdout.splitlines()
    board = json.loads(both.run("leaderboard", "track_1", "--task", TASK, "--json").stdout)
    assert len(shown) == 1 + len(board["entries"]) + len(board["baselines"])
    assert board["baselines"]
    assert shown[-1].split()[0] == "-"


def test_unknown_track_is_refused(service: CliService) -> None:
    done = service.run("leaderboard", "track_9")
    assert done.exit_code == 1
    assert "track_9" in str(done.exception)
