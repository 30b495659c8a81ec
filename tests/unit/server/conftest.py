from collections.abc import Iterator

import pytest
from databases import opened_database
from quota_clock import QuotaClock
from service_factories import make_principal, submit
from vitac.server.accounts import quotas
from vitac.server.database.engine import Database
from vitac.server.database.models import Submission
from vitac.server.principals import Principal


@pytest.fixture
def database() -> Iterator[Database]:
    """A fresh, migrated database."""
    with opened_database() as database:
        yield database


@pytest.fixture
def principal(database: Database) -> Principal:
    """A member of a team."""
    with database.transaction() as session:
        return make_principal(session)


@pytest.fixture
def submission(database: Database, principal: Principal) -> Submission:
    """A model of that team, which waits."""
    with database.transaction() as session:
        return submit(session, principal)


@pytest.fixture
def quota_clock(monkeypatch: pytest.MonkeyPatch) -> QuotaClock:
    """The clock of quotas, which stands still."""
    clock = QuotaClock()
    monkeypatch.setattr(quotas, "read_clock", clock.read)
    return clock
