from datetime import UTC, datetime, timedelta

from service_factories import TASK, make_principal, make_score, make_settings, submit, submit_scored
from submission_steps import refused
from vitac.server.accounts import teams, tokens
from vitac.server.accounts.registration import RegisteringTeam, register
from vitac.server.audit import newest_entries
from vitac.server.database.engine import Database
from vitac.server.errors import ProblemCode
from vitac.server.principals import CONSOLE, Principal

from competitions import make_competition, put_in_place, teams_on_board


def registered(database: Database, name: str, by: Principal | None = None) -> str:
    with database.transaction() as session:
        return register(session, make_settings(), by, RegisteringTeam(name=name))[0].name


def lock_teams(database: Database, after: timedelta) -> None:
    with database.transaction() as session:
        put_in_place(session, make_competition(teams_locked=(datetime.now(UTC) + after).isoformat()))


def test_nobody_but_organizers_registers_a_team_once_teams_are_locked(database: Database) -> None:
    lock_teams(database, timedelta(hours=1))
    assert registered(database, "Ants") == "Ants"
    lock_teams(database, timedelta(hours=-1))
    with refused(ProblemCode.REGISTRATION_CLOSED):
        registered(database, "Bees")
    assert registered(database, "Cats", CONSOLE) == "Cats"


def test_a_team_that_waits_submits_once_an_organizer_accepts_it(database: Database) -> None:
    with database.transaction() as session:
        settings = make_settings(registration="approval")
        team, issued = register(session, settings, None, RegisteringTeam(name="Ants"))
        by = tokens.authenticate(session, issued.secret)
        assert (by.leads_team, [one.name for one in teams.waiting(session)]) == (True, ["Ants"])
        with refused(ProblemCode.TEAM_NOT_ACCEPTED):
            submit(session, by)
        with refused(ProblemCode.FORBIDDEN):
            teams.accept(session, by, team)
        teams.refuse(session, CONSOLE, team, "no such lab")
        assert teams.waiting(session) == []
        with refused(ProblemCode.TEAM_NOT_ACCEPTED):
            submit(session, by)
        for _ in range(2):
            teams.accept(session, CONSOLE, team)
        assert submit(session, by).team_id == team.id
        with refused(ProblemCode.INVALID_REQUEST):
            teams.refuse(session, CONSOLE, team, "too late")
        accepted, refusal = newest_entries(session, 50, subject=f"team:{team.id}")[:2]
        assert (accepted.action, accepted.before) == ("team.accept", {"accepted": False, "reason": "no such lab"})
        assert (refusal.action, refusal.after) == ("team.refuse", {"accepted": False, "reason": "no such lab"})
        assert register(session, settings, CONSOLE, RegisteringTeam(name="Bees"))[0].approved_at is not None


def test_a_team_is_renamed_as_boards_show_at_once(database: Database) -> None:
    with database.transaction() as session:
        ants = make_principal(session, "Ants")
        make_principal(session, "Bees")
        submit_scored(session, ants, "one", {TASK: make_score(50)})
        team = teams.own(session, ants)
        assert teams_on_board(session, task=TASK) == ["Ants"]
        for taken in ("bees", "B\u0435es"):
            with refused(ProblemCode.TEAM_EXISTS):
                teams.rename(session, CONSOLE, team, taken)
        with refused(ProblemCode.FORBIDDEN):
            teams.rename(session, ants, team, "Wasps")
        teams.rename(session, CONSOLE, team, "ANTS")
        assert teams_on_board(session, task=TASK) == ["ANTS"]
        found = newest_entries(session, 1)[0]
        assert (found.action, found.before, found.after) == ("team.rename", {"name": "Ants"}, {"name": "ANTS"})
