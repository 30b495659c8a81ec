from collections.abc import Iterator
from pathlib import Path

import pytest
from sensors_made_once import make_each_once
from service_client import Service, database_with_people, running_service
from vitac.server.database.engine import Database


@pytest.fixture(autouse=True)
def _sensors_are_made_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """A second in the sandbox for each; `tests/integration/sandbox/test_sensor` is about that."""
    monkeypatch.setattr("vitac.worker.short_runs.make_sensor", make_each_once)


@pytest.fixture
def database() -> Iterator[Database]:
    """A fresh, migrated database with the people of a service."""
    with database_with_people() as database:
        yield database


@pytest.fixture
def service(database: Database, tmp_path: Path) -> Iterator[Service]:
    """A service with one team's token, its HTTP client and a database of its own."""
    with running_service(database, tmp_path) as service:
        yield service
