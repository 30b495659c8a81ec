"""An anonymous competition over a real service: nothing that others get says whose a submission is."""

import json
from collections.abc import Iterator
from datetime import UTC, datetime

import pytest
from cli_service import CliService, cli_service
from served_pages import team_visitor, visitor, visitor_of_role
from service_factories import LOCK, TASK, TRACK, make_score, make_upload, play_all, submit, submit_scored
from sqlalchemy import ColumnElement, select, update
from vitac.evaluator.submission_kinds import SubmissionKind
from vitac.server.accounts import teams
from vitac.server.accounts.shown_names import ShownNames
from vitac.server.competitions.competition import Competition
from vitac.server.database.models import CompetitionRow, Submission, Team
from vitac.server.database.states import Role
from vitac.server.evaluations.logs import LogClaim
from vitac.server.leaderboards.standings import leaderboard
from vitac.server.principals import CONSOLE, VISITOR, Principal
from vitac.server.submissions import creation
from vitac.server.submissions.files import receipts

from competitions import make_competition, open_now, put_in_place, shown_stage

NAME, OTHER = "Quokkas", "Wombats"


def member_of(team: Team) -> Principal:
    return Principal(role=Role.TEAM, team_id=team.id, team_name=team.name, leads_team=True)


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[CliService]:
    """A service with a public result of each of two teams, in an anonymous competition."""
    with cli_service(tmp_path_factory.mktemp("service") / "state", team=NAME) as service:
        competition = open_now(make_competition(anonymous=True))
        competition["tracks"][TRACK]["stages"][0]["accepts"].append("text_log")
        with service.database.transaction() as session:
            put_in_place(session, competition)
            own, other = teams.find(session, NAME), teams.register(session, CONSOLE, name=OTHER)
            submission = submit(session, member_of(own), tasks=(TASK, LOCK))
            submit_scored(session, member_of(other), "theirs", {TASK: make_score(50)})
        play_all(service.database, submission)
        uploads = [
            (own, SubmissionKind.LOG, "of its model"),
            (own, SubmissionKind.TEXT_LOG, "of 2025"),
            (other, SubmissionKind.LOG, "a copy"),
        ]
        for team, kind, name in uploads:
            claim = LogClaim(team=team.name, episodes=270, successes=270, success_rate=1.0, mean_steps=3.0)
            upload = make_upload(name, kind=kind, manifest=claim.stored(), name=name)
            with service.database.transaction() as session:
                log, _ = creation.create(session, member_of(team), upload)
            play_all(service.database, log)
        with service.database.transaction() as session:
            session.execute(update(Submission).values(is_public=True))
        yield service


def model_of(team: Team) -> tuple[ColumnElement[bool], ...]:
    return Submission.team_id == team.id, Submission.kind == SubmissionKind.MODEL


def addresses(submission: Submission) -> list[str]:
    """Whatever shows a submission to others, or lists teams."""
    page, api = f"/submissions/{submission.id}", f"/api/v1/submissions/{submission.id}"
    return [
        "/",
        "/competition",
        "/announcements",
        "/receipts",
        "/api/v1/competition",
        "/api/v1/receipts",
        f"/tracks/{TRACK}",
        f"/tracks/{TRACK}?task={TASK}",
        f"/tracks/{TRACK}?search={NAME}",
        f"/tracks/{TRACK}/leaderboard.csv",
        f"/tracks/{TRACK}/logs",
        f"/tracks/{TRACK}/logs.csv",
        f"/tracks/{TRACK}/text-logs.csv",
        f"/api/v1/leaderboards/{TRACK}",
        f"/api/v1/leaderboards/{TRACK}?task={TASK}",
        f"/api/v1/leaderboards/{TRACK}/logs",
        page,
        f"{page}/episodes/{TASK}/1",
        f"{page}/compare",
        f"{page}/episodes.csv",
        api,
        f"{api}/episodes",
        f"{api}/receipts",
        f"{api}/log?task={TASK}",
    ]


@pytest.mark.slow
def test_nobody_else_is_told_a_team_s_name_and_its_members_and_organizers_are(service: CliService) -> None:
    with service.database.transaction() as session:
        team = teams.find(session, NAME)
        hidden_as = team.pseudonym
        submission = session.scalars(select(Submission).where(*model_of(team))).one()
    anybody, others = visitor(service), team_visitor(service, OTHER)
    told = []
    for reader in (anybody, others):
        for address in addresses(submission):
            answer = reader.get(address)
            text = answer.text.replace(f"search={NAME}", "").replace(f'value="{NAME}"', "").replace(f"“{NAME}”", "")
            assert NAME not in text, address
            assert str(team.id) not in text, f"{address} tells the id, by which other pages could be compared"
            told += [address] if hidden_as in text else []
    for shown in (f"/tracks/{TRACK}", f"/tracks/{TRACK}/leaderboard.csv", f"/submissions/{submission.id}"):
        assert told.count(shown) == 2, shown
    assert f"/api/v1/leaderboards/{TRACK}" in told
    own, organizer = team_visitor(service, NAME), visitor_of_role(service, Role.ORGANIZER)
    assert f"others see the team as {hidden_as}" in own.get("/team").text
    assert 'id="own"' in own.get(f"/tracks/{TRACK}").text, "its row is still marked as its own"
    assert 'id="own"' in others.get(f"/tracks/{TRACK}").text
    assert 'id="own"' not in anybody.get(f"/tracks/{TRACK}").text
    for reader in (own, organizer, visitor_of_role(service, Role.JUDGE)):
        assert NAME in reader.get(f"/submissions/{submission.id}").text
    me = json.loads(service.run("whoami", "--json").stdout)["team"]
    assert (me["name"], me["shown_as"], me["id"]) == (NAME, hidden_as, str(team.id))
    assert hidden_as in service.run("whoami").stdout
    listed = json.loads(service.run("admin", "team", "list", "--json").stdout)
    assert {(one["name"], one["shown_as"]) for one in listed} >= {(NAME, hidden_as)}


def test_logs_tell_no_name_that_stands_in_their_header_or_that_they_were_copied_from(service: CliService) -> None:
    with service.database.transaction() as session:
        hidden_as = teams.find(session, NAME).pseudonym
        logs = session.scalars(select(Submission).where(Submission.kind != SubmissionKind.MODEL)).all()
    assert {log.name for log in logs} == {"of its model", "of 2025", "a copy"}
    for reader in (visitor(service), team_visitor(service, OTHER)):
        for address in (f"{prefix}/submissions/{log.id}" for log in logs for prefix in ("", "/api/v1")):
            answer = reader.get(address)
            assert answer.status_code == 200, address
            assert hidden_as in answer.text, address
            assert NAME not in answer.text, address
    (copied,) = (log for log in logs if log.name == "a copy")
    assert NAME in visitor_of_role(service, Role.ORGANIZER).get(f"/submissions/{copied.id}").text, "it is a copy"


def test_when_a_hidden_team_registered_is_not_told(service: CliService) -> None:
    with service.database.transaction() as session:
        team = teams.find(session, NAME)
        submission = session.scalars(select(Submission).where(*model_of(team))).one()
        for principal, is_told in ((member_of(team), True), (CONSOLE, True), (VISITOR, False)):
            view = teams.team_view(team, ShownNames.read(session, principal))
            assert view.created_at == (team.created_at if is_told else None)
    told = visitor(service).get(f"/api/v1/submissions/{submission.id}").json()["team"]
    assert (told["name"], told["created_at"]) == (team.pseudonym, None)


def test_organizers_boards_winners_and_receipts_have_the_names(service: CliService) -> None:
    with service.database.transaction() as session:
        team = teams.find(session, NAME)
        live = leaderboard(session, shown_stage(session, TRACK), live=True).view
        seen = leaderboard(session, shown_stage(session, TRACK)).view
        assert [entry.team for entry in live.entries] == [NAME, OTHER]
        assert {entry.team for entry in seen.entries}.isdisjoint({NAME, OTHER})
        submission = session.scalars(select(Submission).where(*model_of(team))).one()
        (receipt,) = receipts(session, member_of(team), submission.id)
        assert receipt.result.is_of_team(NAME), "so that the audit works with the names that are published at the end"
        assert ShownNames.read(session, member_of(team)).show_id(team) == team.id
        assert ShownNames.read(session, VISITOR).show_id(team) != team.id


def test_the_names_are_shown_again_once_the_competition_is_final(service: CliService) -> None:
    anybody = visitor(service)
    with service.database.transaction() as session:
        hidden_as = teams.find(session, NAME).pseudonym
        row = session.get_one(CompetitionRow, "cup")
        row.finalized_at, row.winners = datetime.now(UTC), []
    assert NAME in anybody.get(f"/tracks/{TRACK}").text
    assert hidden_as not in anybody.get(f"/tracks/{TRACK}").text
    assert NAME in anybody.get(f"/tracks/{TRACK}/leaderboard.csv").text
    with service.database.transaction() as session:
        row = session.get_one(CompetitionRow, "cup")
        row.finalized_at = row.winners = None
        assert Competition.read(session).hides_names
        row.definition = row.definition | {"anonymous": False}
        assert not Competition.read(session).hides_names
        assert ShownNames.read(session).show_name(teams.find(session, NAME)) == NAME
        row.definition = row.definition | {"anonymous": True}
