"""Keys of stations: one agent at a time has one, its clock is right, and what is refused is said in a sentence."""

import os
import platform
from datetime import UTC, datetime, timedelta
from typing import Any
from uuid import UUID, uuid4

import pytest
from service_factories import make_settings
from sqlalchemy import select
from submission_steps import make_worker
from vitac.server.accounts import stations
from vitac.server.database.engine import Database
from vitac.server.database.models import LivePicture
from vitac.server.database.states import WorkerState
from vitac.server.errors import ServiceError
from vitac.server.principals import CONSOLE

NO_PROCESS = 2**22 + 1
"""Above the largest process id of Linux."""


@pytest.fixture
def key(database: Database) -> str:
    with database.transaction() as session:
        return stations.add_station(session, CONSOLE, "lab")


def agent(database: Database, **changes: Any) -> UUID:
    worker_id = uuid4()
    make_worker(database, id=worker_id, **{"host": platform.node(), "pid": os.getpid()} | changes)
    return worker_id


def enrol(database: Database, key: str, worker_id: UUID, twin: str | None = None) -> str:
    with database.transaction() as session:
        return stations.enrol(session, make_settings(), key, worker_id, twin)


def test_agent_with_the_key_of_a_station_plays_for_it(database: Database, key: str) -> None:
    worker_id = agent(database)
    assert enrol(database, key, worker_id) == "lab"
    assert enrol(database, key, worker_id) == "lab"
    with database.transaction() as session:
        assert [(each.name, each.worker_id) for each in stations.list_stations(session)] == [("lab", worker_id)]


def test_station_is_what_its_present_agent_plays_on_and_shows_no_picture_from_before(
    database: Database, key: str
) -> None:
    twin, worker_id = "a twin of class A, no hardware", agent(database)
    enrol(database, key, worker_id, twin)
    with database.transaction() as session:
        names = {"competition": "cup", "track": "t", "stage": "s"}
        session.add(LivePicture(station="lab", picture=b"of a twin", **names))
    for present, pictures in ((twin, 1), (None, 0)):
        enrol(database, key, worker_id, present)
        with database.transaction() as session:
            assert [each.twin for each in stations.list_stations(session)] == [present]
            assert len(session.scalars(select(LivePicture)).all()) == pictures


def test_second_agent_with_the_same_key_is_refused(database: Database, key: str) -> None:
    enrol(database, key, agent(database))
    with pytest.raises(ServiceError, match=f"The key of station lab is in use by process {os.getpid()} on"):
        enrol(database, key, agent(database))


@pytest.mark.parametrize(
    "changes",
    [
        {"pid": NO_PROCESS},
        {"host": "elsewhere", "heartbeat_at": datetime.now(UTC) - timedelta(hours=1)},
        {"state": WorkerState.STOPPED},
    ],
)
def test_agent_follows_one_that_was_killed_or_has_ended(database: Database, key: str, changes: dict[str, Any]) -> None:
    enrol(database, key, agent(database, **changes))
    assert enrol(database, key, agent(database)) == "lab"


def test_agent_elsewhere_that_was_heard_lately_is_not_followed(database: Database, key: str) -> None:
    enrol(database, key, agent(database, host="elsewhere", pid=NO_PROCESS))
    with pytest.raises(ServiceError, match=f"process {NO_PROCESS} on elsewhere"):
        enrol(database, key, agent(database))


def test_unknown_and_removed_keys_are_refused(database: Database, key: str) -> None:
    with database.transaction() as session:
        stations.remove_station(session, CONSOLE, "lab")
    for unknown in (key, "station_other"):
        with pytest.raises(ServiceError, match="No station has this key"):
            enrol(database, unknown, agent(database))


def test_clock_off_by_minutes_is_refused_and_nobody_is_enrolled(
    database: Database, key: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Ahead(datetime):
        @classmethod
        def now(cls, tz: Any = None) -> Any:
            return datetime.now(tz) + timedelta(minutes=5)

    monkeypatch.setattr(stations, "datetime", Ahead)
    with pytest.raises(ServiceError, match="off by 300 s from the database's: expected at most 30 s"):
        enrol(database, key, agent(database))
    with database.transaction() as session:
        assert stations.list_stations(session)[0].worker_id is None


def test_second_station_of_a_name_is_refused(database: Database, key: str) -> None:
    assert key.startswith("station_")
    with database.transaction() as session, pytest.raises(ServiceError, match="There is a station lab already"):
        stations.add_station(session, CONSOLE, "lab")
