from collections.abc import Iterator

import pytest
from databases import fresh_database
from quota_clock import QuotaClock
from vitac.server import quotas
from vitac.server.db.engine import Database


@pytest.fixture
def database() -> Iterator[Database]:
    """A fresh, migrated database."""
    with fresh_database() as address:
        database = Database(address)
        yield database
        database.dispose()


@pytest.fixture
def quota_clock(monkeypatch: pytest.MonkeyPatch) -> QuotaClock:
    """The clock of quotas, which stands still."""
    clock = QuotaClock()
    monkeypatch.setattr(quotas, "datetime", clock)
    return clock
