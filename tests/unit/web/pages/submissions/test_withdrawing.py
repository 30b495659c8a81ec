from collections.abc import Iterator

import pytest
from cli_service import CliService, cli_service
from served_pages import team_visitor
from service_factories import TASK, make_score, submit_scored
from vitac.server.accounts import teams
from vitac.server.database.states import Role
from vitac.server.principals import Principal


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[CliService]:
    with cli_service(tmp_path_factory.mktemp("service") / "state") as service:
        yield service


def test_a_team_withdraws_puts_back_and_deletes_its_submission_on_its_page(service: CliService) -> None:
    ours, others = team_visitor(service), team_visitor(service, "Others")
    with service.database.transaction() as session:
        own = teams.find(session, "Team A")
        by = Principal(role=Role.TEAM, team_id=own.id, team_name=own.name)
        page = f"/submissions/{submit_scored(session, by, 'best', {TASK: make_score(90)}).id}"
    board = "/tracks/track_1?task=peg-insertion"
    assert ours.send(page, f"{page}/withdraw").headers["location"] == page
    assert "Its team withdrew this submission on" in ours.get(page).text
    assert "Team A" not in others.get(board).text.partition("<main")[2]
    assert ours.send(page, f"{page}/restore").status_code == 303
    assert "Team A" in others.get(board).text.partition("<main")[2]
    assert others.send("/team", f"{page}/delete").status_code == 404
    assert ours.send(page, f"{page}/delete").status_code == 303
    assert "Its team deleted this submission on" in ours.get(page).text
    assert f'action="{page}/restore"' not in ours.get(page).text
