import pytest
from asked_playbacks import Played, played
from vitac.server.database.engine import Database


@pytest.fixture
def team_a(database: Database) -> Played:
    return played(database)
