import re
from collections.abc import Iterator

import pytest
from cli_service import CliService, cli_service
from served_pages import team_visitor, visitor, visitor_of_role
from service_factories import make_principal, play_all, submit
from sqlalchemy import update
from vitac.server.accounts import teams
from vitac.server.audit import newest_entries
from vitac.server.database.models import EpisodeDifference, Submission, Team
from vitac.server.database.states import Role
from vitac.server.evaluations.history import newest_evaluation
from vitac.server.operations.desk import stages, troubles
from vitac.server.principals import CONSOLE, Principal

from competitions import make_competition, put_in_place


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[CliService]:
    with cli_service(tmp_path_factory.mktemp("service") / "state") as service:
        yield service


def played(service: CliService) -> Submission:
    """A finished submission of Team A, where appeals are possible."""
    with service.database.transaction() as session:
        content = make_competition(appeal_days=7)
        content["tracks"] = {"mail": content["tracks"]["track_1"] | {"taken_here": False}}
        put_in_place(session, content)
        own = teams.find(session, "Team A")
        submission = submit(session, Principal(role=Role.TEAM, team_id=own.id, team_name=own.name))
    play_all(service.database, submission)
    return submission


def test_an_organizer_settles_what_waits_and_everybody_sees_what_is_theirs(service: CliService) -> None:
    team, organizer = team_visitor(service), visitor_of_role(service, Role.ORGANIZER)
    judge, anybody = visitor_of_role(service, Role.JUDGE), visitor(service)
    submission = played(service)
    with service.database.transaction() as session:
        waiting = [teams.register(session, CONSOLE, name=name, waits=True) for name in ("Bees", "Cats")]

    assert team.send("/announcements", "/announcements/ask", text="<script>?", public="yes").status_code == 303
    opened = team.send("/appeals", "/appeals/open", submission_id=str(submission.id), text="Look again.")
    assert opened.status_code == 303, opened.text
    assert team.send("/appeals", "/appeals/open", submission_id="x", text="Look again.").status_code == 422
    shown = organizer.get("/desk").text
    for what in ("Bees", "Cats", "&lt;script&gt;?", "Look again.", "appeal.open"):
        assert what in shown
    assert "&lt;script&gt;?" not in anybody.get("/announcements").text
    number = re.search(r'action="/desk/answer">.*?name="id" value="(\d+)"', shown, re.DOTALL)
    assert number is not None
    appeal = re.search(r'action="/desk/rule">.*?name="id" value="(\d+)"', shown, re.DOTALL)
    assert appeal is not None
    for target, fields in (
        ("accept", {"id": str(waiting[0].id)}),
        ("refuse", {"id": str(waiting[1].id), "reason": "no such lab"}),
        ("answer", {"id": number[1], "text": "Yes & no.", "public": "yes"}),
        ("rule", {"id": appeal[1], "text": "It was right.", "upheld": "no"}),
        ("announce", {"title": "News", "text": "All is well."}),
    ):
        answer = organizer.send("/desk", f"/desk/{target}", **fields)
        assert (answer.status_code, answer.headers.get("location")) == (303, "/desk"), answer.text
        assert team.send("/announcements", f"/desk/{target}", **fields).status_code == 403
    public = anybody.get("/announcements").text
    for what in ("&lt;script&gt;?", "Yes &amp; no.", "News", "All is well."):
        assert what in public
    assert "Team A" not in public
    assert "It was right." in team.get("/appeals").text
    assert "It was right." in judge.get("/appeals").text
    assert 'action="/appeals/open"' not in judge.get("/appeals").text
    assert judge.get("/desk").status_code == team.get("/desk").status_code == 403
    assert anybody.get("/desk").status_code == anybody.get("/appeals").status_code == 303
    assert organizer.send("/desk", "/desk/nothing").status_code == 404
    for wrong in ("x", "0", "9" * 20):
        assert organizer.send("/desk", "/desk/hide", id=wrong).status_code == 422
    with service.database.transaction() as session:
        states = {one.name: (one.approved_at is not None, one.refused_for) for one in session.query(Team)}
        assert (states["Bees"], states["Cats"]) == ((True, None), (False, "no such lab"))
        assert newest_entries(session, 1)[0].action == "announcement.publish"


def test_submissions_in_trouble_and_stages_are_listed(service: CliService) -> None:
    with service.database.transaction() as session:
        put_in_place(session, make_competition())
    shown = visitor_of_role(service, Role.ORGANIZER).get("/desk").text
    assert '<a href="/tracks/track_1?stage=stage2">Touch, Final</a>' in shown
    with service.database.transaction() as session:
        state = {one.stage.name: (one.qualified, one.submissions, one.over) for one in stages(session, CONSOLE)}
        assert state == {"stage1": (None, 0, False), "stage2": (0, 0, False)}
        session.execute(update(Team).values(disqualified_at=None, disqualified_for=None))
        content = make_competition()
        content["tracks"] = {"mail": content["tracks"]["track_1"] | {"taken_here": False}}
        put_in_place(session, content)
        assert list(stages(session, CONSOLE)) == []
        submission = submit(session, make_principal(session, "Wasps"), "differs")
        assert troubles(session, CONSOLE) == []
        evaluation = newest_evaluation(session, submission)
        session.add(
            EpisodeDifference(
                evaluation_id=evaluation.id,
                task="peg-insertion",
                episode=1,
                stored_digest="0" * 64,
                differing_digest="1" * 64,
            )
        )
        session.flush()
        (found,) = troubles(session, CONSOLE)
        assert (found.team, "another result" in found.problem) == ("Wasps", True)
