import pytest
from service_factories import (
    make_principal,
)
from vitac.server.accounts.principals import Principal
from vitac.server.db.engine import Database


@pytest.fixture
def principal(database: Database) -> Principal:
    with database.transaction() as session:
        return make_principal(session)
