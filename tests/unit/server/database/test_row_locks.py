"""Work that needs rows which somebody else holds is passed over, and nothing of it is done."""

import pytest
from service_factories import make_principal
from sqlalchemy import select, text, update
from sqlalchemy.exc import OperationalError
from sqlalchemy.orm import Session
from vitac.server.database.engine import Database
from vitac.server.database.locks import LOCK_WAIT, unless_held
from vitac.server.database.models import Team


def rename(session: Session, *teams: str) -> int:
    """Renames teams, one after the other; how many."""
    for name in teams:
        session.execute(
            update(Team).where(Team.name == name).values(name=Team.name + "!", name_key=Team.name_key + "!")
        )
    assert session.scalar(text("SHOW lock_timeout")) == LOCK_WAIT
    return len(teams)


def names(session: Session) -> list[str]:
    return list(session.scalars(select(Team.name).order_by(Team.name)))


def test_work_that_needs_a_held_row_is_undone_and_the_transaction_goes_on(database: Database) -> None:
    with database.transaction() as session:
        for letter in "ABC":
            make_principal(session, f"Team {letter}")
    with database.transaction() as stuck:
        stuck.scalars(select(Team).where(Team.name == "Team B").with_for_update()).one()
        with database.transaction() as session:
            assert unless_held(session, lambda: rename(session, "Team A", "Team B")) is None
            assert unless_held(session, lambda: rename(session, "Team C")) == 1
            assert session.scalar(text("SHOW lock_timeout")) == "0"
    with database.transaction() as session:
        assert names(session) == ["Team A", "Team B", "Team C!"]
        assert unless_held(session, lambda: rename(session, "Team A", "Team B")) == 2
    with database.transaction() as session:
        assert names(session) == ["Team A!", "Team B!", "Team C!"]


def test_changes_that_were_not_written_yet_wait_no_longer_either(database: Database) -> None:
    with database.transaction() as session:
        make_principal(session, "Team A")
    with database.transaction() as stuck, database.transaction() as session:
        team = session.scalars(select(Team)).one()
        stuck.scalars(select(Team).with_for_update()).one()
        session.execute(text("SET LOCAL statement_timeout = '60s'"))

        def change() -> bool:
            team.name_key = "b"
            return True

        assert unless_held(session, change) is None
        assert team.name_key != "b"


def test_any_other_error_is_raised(database: Database) -> None:
    def sleep_too_long() -> None:
        session.execute(text("SET LOCAL statement_timeout = '20ms'"))
        session.execute(text("SELECT pg_sleep(60)"))

    with database.transaction() as session, pytest.raises(OperationalError, match="statement timeout"):
        unless_held(session, sleep_too_long)
