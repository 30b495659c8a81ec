from collections.abc import Iterator

import pytest
from databases import fresh_database
from vitac.server.db.engine import Database


@pytest.fixture
def database() -> Iterator[Database]:
    """A fresh, migrated database."""
    with fresh_database() as address:
        database = Database(address)
        yield database
        database.dispose()
