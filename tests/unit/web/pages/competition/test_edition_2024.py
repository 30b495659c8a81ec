"""The competition of 2024 beside an open one: an archive, with tasks whose rules can be read."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from cli_service import CliService, cli_service
from served_pages import visitor
from vitac.server.competitions.definition import read_competition

from competitions import make_competition, open_now, put_in_place


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[CliService]:
    with cli_service(tmp_path_factory.mktemp("service") / "state") as service:
        past = read_competition(Path(__file__).parents[5] / "competitions" / "vitac-2024.yaml")
        with service.database.transaction() as session:
            put_in_place(session, past.model_dump(mode="json"))
            put_in_place(session, open_now(make_competition()))
        yield service


def test_it_is_among_past_competitions_and_the_front_page_calls_for_the_open_one(service: CliService) -> None:
    present, past = visitor(service).get("/competitions").text.split('<h2 id="past">')
    assert 'href="/competitions/vitac-2024"' not in present
    assert 'href="/competitions/vitac-2024"' in past
    assert 'href="/competitions/cup"' in present
    front = visitor(service).get("/").text
    assert "ManiSkill-ViTac Challenge 2024</a>: Simulation is open" not in front
    assert "is open until" in front


def test_its_page_leads_to_its_board_which_takes_nothing_and_to_its_rules(service: CliService) -> None:
    everybody = visitor(service)
    page = everybody.get("/competitions/vitac-2024").text
    assert "All its stages have closed." in page
    assert "re-simulated by <code>vitac log verify</code>" in page
    assert "All its stages have closed." not in everybody.get("/competitions/cup").text
    assert 'href="/competitions/vitac-2024/tracks/vitac_2024"' in page
    assert everybody.get("/competitions/vitac-2024/tracks/vitac_2024").status_code == 200
    rules = everybody.get("/tracks/vitac_2024/rules").text
    for text in (
        "180 public starts",
        "160 public starts",
        "class default of 0.5",
        "Nothing is clipped",
        "between 37 and",
    ):
        assert text in rules
    for task in ("peg-insertion-2024", "lock-opening-2024"):
        assert f"/static/{task}.webp" in rules
