import re
from collections.abc import Iterator

import pytest
from cli_service import CliService, cli_service
from served_pages import team_visitor, visitor, visitor_of_role
from service_factories import TASK, TRACK, make_principal, make_score, submit_scored
from vitac.server.database.states import Role
from vitac.server.decisions.judging import judged
from vitac.server.principals import CONSOLE

from competitions import make_competition, open_now, put_in_place, shown_stage

STRUCTURE = "A <new> structure"


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[CliService]:
    with cli_service(tmp_path_factory.mktemp("service") / "state") as service:
        yield service


def judged_track(service: CliService) -> dict[str, str]:
    """A judged track with two scored teams; the ids of their submissions."""
    content = make_competition()
    del content["tracks"][TRACK]["stages"][1]
    content["tracks"][TRACK]["judging"] = {
        "criteria": [{"name": "structure", "title": STRUCTURE}, {"name": "clarity", "title": "The words"}],
        "weights": {"success": 0.5, "judges": 0.5, "figures": 0},
    }
    with service.database.transaction() as session:
        put_in_place(session, open_now(content))
        return {
            name: str(submit_scored(session, make_principal(session, name), name, {TASK: make_score(successes)}).id)
            for name, successes in (("<Ants>", 80), ("Bees", 60))
        }


def test_judges_give_marks_on_their_page_and_organizers_see_the_spread(service: CliService) -> None:
    judge, organizer = visitor_of_role(service, Role.JUDGE), visitor_of_role(service, Role.ORGANIZER)
    team, anybody = team_visitor(service), visitor(service)
    assert "No track has judges." in judge.get("/judging").text
    ids = judged_track(service)
    shown = judge.get("/judging").text
    for what in ("A &lt;new&gt; structure", "&lt;Ants&gt;", f"/submissions/{ids['Bees']}", 'name="mark-clarity"'):
        assert what in shown, what
    assert "Spread" not in shown
    assert 'name="judge"' not in shown
    assert f"/submissions/{ids['Bees']}/sensor" not in shown, "a track without sensors"
    assert team.get("/judging").status_code == 403
    assert anybody.get("/judging").status_code == 303

    marks = {"id": ids["Bees"], "mark-structure": "8", "mark-clarity": "6.5"}
    assert judge.send("/judging", "/judging/marks", **marks).headers["location"] == "/judging"
    assert team.send("/announcements", "/judging/marks", **marks).status_code in {403, 404}
    for wrong in ({"mark-structure": "x"}, {"mark-structure": "11"}, {"mark-structure": "nan"}, {"id": "x"}):
        assert judge.send("/judging", "/judging/marks", **(marks | wrong)).status_code == 422, wrong
    assert organizer.send("/judging", "/judging/marks", **marks).status_code == 422, "no judge is named"
    more = marks | {"judge": "Prof. X", "mark-structure": "10", "mark-clarity": "10"}
    assert organizer.send("/judging", "/judging/marks", **more).status_code == 303
    shown = judge.get("/judging").text
    assert re.findall(r'name="mark-\w+"[^>]* value="([^"]*)"', shown) == ["", "", "8.0", "6.5"]
    assert "Change marks" in shown
    table = organizer.get("/judging").text
    for what in ("8.62", "1.94", "Spread"):  # 7.25 and 10
        assert what in table, what

    refused = judge.send("/judging", "/judging/conflict", team="Bees", reason=" ")
    assert refused.status_code == 422
    assert judge.send("/judging", "/judging/conflict", team="Bees", reason="I <advise>").status_code == 303
    assert "You do not judge this team: I &lt;advise&gt;." in judge.get("/judging").text
    assert judge.send("/judging", "/judging/marks", **marks).status_code == 403
    with service.database.transaction() as session:
        (bees,) = [one for one in judged(session, CONSOLE, shown_stage(session, TRACK)) if one.team == "Bees"]
    assert (bees.judges, len(bees.conflicts)) == (("Prof. X",), 1)
