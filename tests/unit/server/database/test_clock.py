"""The database's clock is the only one: a machine whose own is wrong changes nothing that is stored or decided."""

from pathlib import Path

import vitac.server
from vitac.server.database.clock import read_clock
from vitac.server.database.engine import Database

WITHOUT_TRANSACTION = {
    "accounts/stations.py": "measures how far a station's clock is off",
    "leaderboards/log_boards.py": "says when a page was put together",
    "leaderboards/standings.py": "says when a page was put together",
    "operations/backup.py": "names a file",
    "storage/blobs.py": "compares with the times of files",
}


def test_the_clock_of_the_database_has_a_time_zone(database: Database) -> None:
    with database.transaction() as session:
        assert read_clock(session).utcoffset() is not None


def test_no_other_clock_is_read_where_something_is_stored_or_decided() -> None:
    folder = Path(next(iter(vitac.server.__path__)))
    reading = {str(path.relative_to(folder)) for path in folder.rglob("*.py") if "datetime.now(" in path.read_text()}
    assert reading == WITHOUT_TRANSACTION.keys()
