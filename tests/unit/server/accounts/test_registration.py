from datetime import UTC, datetime, timedelta

from service_factories import make_settings
from submission_steps import refused
from vitac.server.accounts.principals import CONSOLE, Principal
from vitac.server.accounts.registration import NewTeam, register
from vitac.server.db.engine import Database
from vitac.server.errors import ProblemCode

from competitions import make_competition, put_in_place


def registered(database: Database, name: str, by: Principal | None = None) -> str:
    with database.transaction() as session:
        return register(session, make_settings(), by, NewTeam(name=name))[0].name


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
