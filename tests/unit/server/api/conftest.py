from collections.abc import Iterator
from pathlib import Path

import pytest
from service_client import Service, running_service
from vitac.server.db.engine import Database


@pytest.fixture
def service(database: Database, tmp_path: Path) -> Iterator[Service]:
    """A service with one team's token, its HTTP client and a database of its own."""
    with running_service(database, tmp_path) as service:
        yield service
